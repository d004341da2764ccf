"""Dialogue of ``tactiled setup``: search, proposal, files, commands."""

import json
from pathlib import Path

import click

from tactiled.doctor.finding import as_text
from tactiled.setup.apply import check_other_port, remove, run_commands, taken_ports, write, written_for
from tactiled.setup.find import examine, find_ports, port_at
from tactiled.setup.plan import SetupPlan, make_plan, serves_all_boards


def run_setup(
    name: str | None, port: str | None, array: str | None, tcp_port: int | None, root: Path, *, dry_run: bool
) -> int:
    """Find a board, and write its service or print it; return the exit code: 1 where no board answers.

    `ConfigError` if the proposal would be invalid, or another board has the name; `OperatorError` if a file
    cannot be written.
    """
    ports = [port_at(port)] if port is not None else find_ports()
    if not ports:
        _say("no USB serial port: plug the board in, or give --port")
        return 1
    boards = []
    for candidate in ports:
        _say(f"looking at {candidate.url} ...")
        board = examine(candidate, array)
        _say(as_text(board.findings))
        if board.protocol:
            boards.append(board)
    if not boards:
        _say("no board answered; what is above says what to correct")
        return 1
    if len(boards) > 1:
        _say("several boards answered: choose one with --port " + " or ".join(b.port.url for b in boards))
        return 1
    board = boards[0]
    plan = make_plan(board, name, tcp_port, taken=taken_ports(root), for_all=serves_all_boards(root))
    check_other_port(plan, board.port.url, root)
    if dry_run:
        _print(plan)
        return 0
    write(plan, root, _say)
    if root == Path("/"):
        run_commands(plan.commands, _say)
    for note in plan.notes:
        _say(f"note       {note}")
    click.echo(json.dumps({"name": plan.name, "port": board.port.url, "files": [f.path for f in plan.files]}))
    return 0


def run_remove(name: str, root: Path) -> None:
    """Undo the setup of a board; errors as for `remove`."""
    written_for(name, root)  # before a unit is stopped, which somebody else may have made
    if root == Path("/"):
        run_commands((("systemctl", "disable", "--now", f"tactiled@{name}.service"),), _say)
    remove(name, root, _say)
    if root == Path("/"):
        commands = [("systemctl", "daemon-reload"), ("udevadm", "control", "--reload")]
        if serves_all_boards(root):
            commands.append(("systemctl", "try-restart", "tactiled.service"))
        run_commands(commands, _say)


def _print(plan: SetupPlan) -> None:
    for file in plan.files:
        click.echo(f"# ---- {file.path}{' (shared by all boards)' if file.shared else ''}\n{file.text}")
    for command in plan.commands:
        click.echo(f"# would run: {' '.join(command)}")


def _say(words: str) -> None:
    click.echo(words, err=True)
