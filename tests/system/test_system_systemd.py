"""The Debian package and the shipped unit under a real systemd: what users rely on.

One Debian for all: the package is the first in it and leaves nothing, then come the wheels.
"""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from nspawn import (
    CHECKOUT,
    NEW,
    OLD,
    UNITS,
    Container,
    ContainerError,
    make_all,
    wait_until,
)
from patience import PATIENCE_S

from tactiled.client import Fresh, Item, Message, Restarted, Stale, Subscription

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]  # seconds; a Debian is made on two cores
LEFT, RIGHT = "TS0001", "TS0002"
PORTS = {LEFT: 9872, RIGHT: 9874}
PACKAGES = "/wheels/packages"


@pytest.fixture(scope="module")
def debian(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Container]:
    """A booted Debian that has never heard of tactiled; skipped, with the reason, where none can be."""
    folder = tmp_path_factory.mktemp("debian")
    root, wheels = folder / "root", folder / "all wheels"
    wheels.mkdir()
    try:
        make_all(root, wheels)
        with Container(root, wheels) as booted:
            yield booted
    except ContainerError as reason:
        pytest.skip(f"not tested under a real systemd: {reason}")
    finally:
        subprocess.run(["rm", "-rf", folder], check=False)  # some 60,000 files


@pytest.fixture(scope="module")
def container(debian: Container) -> Container:
    """The Debian with tactiled as docs/service.md says."""
    install(debian)
    return debian


def install(container: Container) -> None:
    container.run("python3", "-m", "venv", "/opt/tactiled")
    upgrade(container, OLD)
    for name in ("tactiled@.service", "tactiled.service"):
        shutil.copy(CHECKOUT / "systemd" / name, container.root / UNITS)
    (container.root / "etc/sysusers.d").mkdir(exist_ok=True)
    shutil.copy(CHECKOUT / "systemd/tactiled.sysusers", container.root / "etc/sysusers.d/tactiled.conf")
    container.run("systemd-sysusers")
    (container.root / "etc/tactiled").mkdir()
    for serial in PORTS:
        configure(container, serial)
    container.run("systemctl", "daemon-reload")


def upgrade(container: Container, version: str) -> None:
    pip = ("/opt/tactiled/bin/pip", "install", "--quiet", "--no-index", "--find-links=/wheels")
    container.run(*pip, f"tactiled[emulator]=={version}")


def configure(container: Container, serial: str, more: str = "") -> None:
    (container.root / f"etc/tactiled/{serial}.toml").write_text(
        f'[port]\nurl = "/dev/tactiled-{serial}"\n'
        f'[publish]\nendpoints = ["tcp://127.0.0.1:{PORTS[serial]}", "ipc://{{runtime}}/events.ipc"]\n'
        f'[session]\nboard_serial = "{serial}"\n{more}'
    )


def unit(serial: str = LEFT) -> str:
    return f"tactiled@{serial}.service"


@contextmanager
def board(container: Container, serial: str) -> Iterator[Path]:
    """Run an emulated board in the container and yield the file of its true scans.

    Its pty has the group and mode that the udev rule gives.
    """
    truth = container.root / f"var/tmp/board-{serial}.jsonl"
    truth.unlink(missing_ok=True)
    (container.root / f"etc/board-{serial}.toml").write_text(f'board_serial = "{serial}"\n')
    name, link = f"board-{serial}", f"/dev/tactiled-{serial}"
    container.run(
        "systemd-run", "--quiet", f"--unit={name}", f"--property=StandardOutput=file:/var/tmp/{truth.name}",
        "/opt/tactiled/bin/tactiled", "emulate", "--scene", "rest", "--scans", "--link", link,
        "--board", f"/etc/board-{serial}.toml",
    )  # fmt: skip
    try:
        wait_until(lambda: truth.exists() and "ready" in truth.read_text(), f"board {serial} is there")
        device = json.loads(truth.read_text().splitlines()[0])["device"]
        container.run("chgrp", "dialout", device)
        container.run("chmod", "0660", device)
        yield truth
    finally:
        container.run("systemctl", "stop", name)


@contextmanager
def started(container: Container, serial: str = LEFT) -> Iterator[Path]:
    """The unit of a board, active, with its board; stopped in the end."""
    with board(container, serial) as truth:
        container.run("systemctl", "start", unit(serial))
        try:
            yield truth
        except BaseException:
            print(container.journal(unit(serial)))  # pytest shows it with the failure
            raise
        finally:
            container.run("systemctl", "stop", unit(serial))
            container.run("systemctl", "reset-failed")


def listening(container: Container, serial: str = LEFT) -> Subscription:
    return Subscription(f"ipc://{container.seen(f'/run/tactiled/{serial}/events.ipc')}")


def until(subscription: Subscription, wanted: Callable[[Item], bool], what: str) -> list[Item]:
    """Items up to the one that is wanted."""
    items: list[Item] = []
    limit_s = time.monotonic() + PATIENCE_S
    while (item := subscription.next_item(limit_s)) is not None:
        items.append(item)
        if wanted(item):
            return items
    raise AssertionError(f"not within {PATIENCE_S:.0f} s: {what}; last {items[-3:]}")


def until_message(subscription: Subscription, topic: str) -> Message:
    """Return the next message of a topic."""
    item = until(subscription, lambda item: isinstance(item, Message) and item.topic == topic, topic)[-1]
    assert isinstance(item, Message)
    return item


def until_fresh_scans(subscription: Subscription) -> list[Item]:
    """Up to the first scan of a board that runs."""
    items = until(subscription, lambda item: isinstance(item, Fresh), "fresh")
    return [*items, until_message(subscription, "scan")]


def found(container: Container) -> set[str]:
    """All that is named after tactiled in the container, but what dpkg remembers."""
    apart = ("-path", "/wheels", "-prune", "-o", "-path", "/var/lib/dpkg", "-prune", "-o")
    return set(container.run("find", "/", "-xdev", *apart, "-name", "*tactiled*", "-print").split())


def test_the_package_from_installation_to_purge(debian: Container) -> None:
    """It is installed without network, runs a board, is upgraded, and purged clean."""
    before = found(debian)
    debian.run("sh", "-c", f"dpkg -i {PACKAGES}/tactiled_{OLD}+py3.11_*.deb")
    assert [*debian.root.glob("opt/tactiled/lib/*/site-packages/tactiled/web/__pycache__/*.pyc")]
    assert debian.run("tactiled", "--version").splitlines()[0] == f"tactiled, version {OLD}"
    assert debian.run("id", "-gn", "tactiled").strip() == "tactiled"
    assert (debian.root / "usr/lib/udev/rules.d/99-tactiled.rules").exists()
    assert debian.run("dpkg", "--verify", "tactiled") == ""
    # As docs/service.md says: the example becomes the configuration of a board.
    example = (debian.root / "etc/tactiled/tactiled.toml.example").read_text()
    assert "[port]" in example
    configure(debian, LEFT)
    with board(debian, LEFT):
        debian.run("systemctl", "start", unit())
        with listening(debian) as subscription:
            until_message(subscription, "scan")

        show_page(debian)
        forward_over_zenoh(debian)
        pids = {int(debian.shown(name, "MainPID")[0]) for name in (unit(), *CLIENTS)}

        debian.run("sh", "-c", f"dpkg -i {PACKAGES}/tactiled_{NEW}+py3.11_*.deb")
        assert debian.run("tactiled", "--version").splitlines()[0] == f"tactiled, version {NEW}"
        for name in (unit(), *CLIENTS):
            assert debian.shown(name, "ActiveState") == ["active"]
            assert int(debian.shown(name, "MainPID")[0]) not in pids  # restarted by the upgrade
        with listening(debian) as subscription:
            info = until_message(subscription, "info").data
        assert info["tactiled_version"] == NEW

        debian.run("systemctl", "enable", unit(), *CLIENTS)
        debian.run("dpkg", "--remove", "tactiled")
        for name in (unit(), *CLIENTS):
            assert debian.shown(name, "ActiveState", "LoadState") == ["inactive", "not-found"]
            assert (debian.root / UNITS / "multi-user.target.wants" / name).is_symlink()  # until purged
        assert (debian.root / f"etc/tactiled/{LEFT}.toml").exists()  # until purged
        rule = "/etc/udev/rules.d/99-tactiled-left.rules"  # as `tactiled setup` writes it
        debian.run("sh", "-c", f"mkdir -p /etc/udev/rules.d && touch {rule}")
        debian.run("dpkg", "--purge", "tactiled")
    (debian.root / f"etc/board-{LEFT}.toml").unlink()
    debian.run("systemctl", "stop", ROUTER)
    for name in CLIENTS:
        shutil.rmtree(debian.root / UNITS / f"{name}.d")
    assert found(debian) == before


WEB, BRIDGE, ROUTER = "tactiled-web.service", f"tactiled-zenoh@{LEFT}.service", "router.service"
CLIENTS = (WEB, BRIDGE)
_READ_PAGE = f"""
import asyncio, aiohttp
async def read():
    address = "http://127.0.0.1:8765/api/live"
    async with aiohttp.ClientSession() as session, session.ws_connect(address) as page:
        while b"{LEFT}" not in (await page.receive_bytes()):
            pass
async def main():
    while True:
        try:
            return await read()
        except aiohttp.ClientConnectionError:  # the page has not begun
            await asyncio.sleep(0.1)
asyncio.run(asyncio.wait_for(main(), {PATIENCE_S}))
"""
_ROUTE = """
import time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("transport/shared_memory/enabled", "false")
config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:7447"]')
with zenoh.open(config):
    time.sleep(1e6)
"""


def edit(container: Container, name: str, lines: str) -> None:
    """Write a drop-in, as `systemctl edit` does."""
    file = container.root / UNITS / f"{name}.d/override.conf"
    file.parent.mkdir(exist_ok=True)
    file.write_text(lines)
    container.run("systemctl", "daemon-reload")


def show_page(container: Container) -> None:
    """The unit of the live page has the board of the daemon, over TCP and over ipc, and no rights."""
    ipc = f"OPTIONS=--events ipc:///run/tactiled/{LEFT}/events.ipc"
    for lines in ("", f'[Service]\nEnvironment="{ipc}"\nSupplementaryGroups=tactiled\n'):
        edit(container, WEB, lines)
        container.run("systemctl", "restart", WEB)
        container.run("/opt/tactiled/bin/python", "-c", _READ_PAGE)
        check_process(container, WEB)


def forward_over_zenoh(container: Container) -> None:
    """The unit of the bridge waits for a router, forwards the board, and has no rights."""
    container.run("systemctl", "start", BRIDGE)  # without a configuration
    assert container.shown(BRIDGE, "ActiveState", "Result") == ["inactive", "success"]
    config = container.root / "etc/tactiled/zenoh.json5"
    config.write_text('{connect: {endpoints: ["tcp/127.0.0.1:7447"]}}')
    config.chmod(0o600)
    edit(container, BRIDGE, '[Service]\nEnvironment="OPTIONS=--host robot7 --rate 50"\n')
    container.run("systemctl", "start", BRIDGE)
    said = "no router of zenoh answers"
    wait_until(lambda: said in container.journal(BRIDGE), said, PATIENCE_S)
    container.run("systemd-run", "--quiet", f"--unit={ROUTER}", "/opt/tactiled/bin/python", "-c", _ROUTE)
    said = "tactile/robot7/**"
    wait_until(lambda: said in container.journal(BRIDGE), said, PATIENCE_S)
    line = container.run(
        "tactiled", "listen", "zenoh://127.0.0.1:7447/robot7", "--topic", "scan", "--count", "1"
    )
    assert json.loads(line)["board"] == LEFT
    check_process(container, BRIDGE)


def check_process(container: Container, name: str) -> None:
    """The process of a unit has a user of its own without rights, and half of its memory to spare."""
    pid, most = container.shown(name, "MainPID", "MemoryMax")
    lines = container.run("cat", f"/proc/{pid}/status").splitlines()
    status = {key: value.split() for key, value in (line.split(":", 1) for line in lines)}
    assert set(status["Uid"]) & {"0", container.run("id", "-u", "tactiled").strip()} == set()
    assert status["CapBnd"] == ["0000000000000000"]
    assert (status["NoNewPrivs"], status["Seccomp"]) == (["1"], ["2"])
    assert int(status["VmHWM"][0]) << 10 < int(most) // 2
    assert container.shown(name, "NRestarts") == ["0"]


STRANGER = "12345"


def asked(container: Container, *words: str, groups: str = "") -> tuple[int, str]:
    """Run tactiled as a user of the host that is in no group but these; exit code and all that it said."""
    membership = ("--groups", groups) if groups else ("--clear-groups",)
    who = ("setpriv", f"--reuid={STRANGER}", f"--regid={STRANGER}", *membership)
    command = " ".join((*who, "/opt/tactiled/bin/tactiled", *words))
    # A login shell's environment has none of root's; what fails must fail for the user, not for the shell.
    shown = container.run("sh", "-c", f"cd /; {command} 2>&1; echo rc=$?")
    text, _, code = shown.rpartition("rc=")
    return int(code), text


@pytest.fixture(scope="class")
def truth(container: Container) -> Iterator[Path]:
    """The unit of a board, started once for a class; gives the file of the board's true scans."""
    with started(container) as file:
        yield file


@pytest.mark.usefixtures("truth")
class TestInstance:
    """What the unit of one board does from its start to its stop."""

    def test_start_waits_for_ready_and_scans_come_over_ipc_and_tcp(self, container: Container) -> None:
        # `systemctl start` returns when READY=1 came: Type=notify.
        assert container.shown(unit(), "ActiveState", "Type") == ["active", "notify"]
        with listening(container) as subscription:
            until_fresh_scans(subscription)
        lines = container.run(
            "/opt/tactiled/bin/tactiled", "listen", "--topic", "scan", "--count", "20"
        ).splitlines()
        assert {json.loads(line)["board"] for line in lines} == {LEFT}
        running = f"board {LEFT} running: 100 Hz"  # a busy host lets it stall now and then
        wait_until(lambda: container.shown(unit(), "StatusText") == [running], running, PATIENCE_S)

    def test_it_runs_as_a_user_of_its_own_with_nothing(self, container: Container) -> None:
        """The hardening is what the process has, not only what the unit says."""
        (pid,) = container.shown(unit(), "MainPID")
        lines = container.run("cat", f"/proc/{pid}/status").splitlines()
        status = {key: value.split() for key, value in (line.split(":", 1) for line in lines)}
        assert "0" not in status["Uid"]
        assert container.run("id", "--name", "--groups", "tactiled").split() == ["tactiled"]
        groups = [container.run("getent", "group", name).split(":")[2] for name in ("tactiled", "dialout")]
        assert status["Gid"] == groups[:1] * 4
        assert sorted(status["Groups"]) == sorted(groups)
        assert status["CapBnd"] == ["0000000000000000"]
        assert (status["NoNewPrivs"], status["Seccomp"]) == (["1"], ["2"])
        assert container.shown(unit(), "MemoryMax") == [str(512 << 20)]
        stats = container.run("sh", "-c", f"cat /proc/{pid}/task/*/stat").splitlines()
        niceness = {line.rpartition(")")[2].split()[16] for line in stats}
        assert niceness == {"0", "10"}  # groove fits yield to scans
        assert int(status["VmHWM"][0]) << 10 < 128 << 20  # which leaves room for what it may hold

    def test_a_user_outside_the_group_neither_hears_over_ipc_nor_commands(self, container: Container) -> None:
        events = f"ipc:///run/tactiled/{LEFT}/events.ipc"
        with listening(container) as subscription:
            until_fresh_scans(subscription)
            code, text = asked(container, "command", "inhibit", "duration_s=60")
            assert (code, "usermod -aG tactiled" in text) == (2, True), text
            for endpoint in (events, "ipc://" + events.removeprefix("ipc://").replace("events", "control")):
                code, text = asked(container, "listen", endpoint, "--count", "1", "--timeout", "2")
                assert code != 0
                assert '"board"' not in text
            over_tcp = ("command", "--endpoint", f"tcp://127.0.0.1:{PORTS[LEFT]}")
            for words in (("inhibit", "duration_s=60"), ("record", "on=false")):
                code, text = asked(container, *over_tcp, *words)
                assert (code, "not taken over TCP" in text) == (1, True), text
            code, text = asked(container, *over_tcp, "state")
            assert code == 0
            assert json.loads(text)["settings"]["inhibited_s"] == 0.0
            said = "request refused: inhibit by an unknown user over TCP"
            wait_until(lambda: said in container.journal(unit()), said, PATIENCE_S)

    def test_a_member_of_the_group_commands_and_is_named(self, container: Container) -> None:
        with listening(container) as subscription:
            until_fresh_scans(subscription)
            code, text = asked(container, "command", "inhibit", "duration_s=60", groups="tactiled")
            assert code == 0, text
            done = until_message(subscription, "command").data
            assert (done["command"], done["uid"], done["ok"]) == ("inhibit", int(STRANGER), True)
            said = f"command: inhibit by uid {STRANGER}: done"
            wait_until(lambda: said in container.journal(unit()), said, PATIENCE_S)
            events = f"ipc:///run/tactiled/{LEFT}/events.ipc"
            words = ("listen", events, "--topic", "scan", "--count", "3")
            code, text = asked(container, *words, groups="tactiled")
            assert code == 0, text
            folder = container.run("stat", "--format=%a %U %G", f"/run/tactiled/{LEFT}").split()
            assert folder == ["750", "tactiled", "tactiled"]
            for name in ("events.ipc", "control.ipc"):
                mode = container.run("stat", "--format=%a %U %G", f"/run/tactiled/{LEFT}/{name}").split()
                assert mode == ["660", "tactiled", "tactiled"]

    @pytest.mark.parametrize("blow", ["STOP", "KILL"])
    def test_it_is_started_anew(self, container: Container, blow: str) -> None:
        """One that hangs is ended by the watchdog."""
        with listening(container) as subscription:
            until_fresh_scans(subscription)
            before, restarts = container.shown(unit(), "MainPID", "NRestarts")
            container.run("systemctl", "kill", "--kill-whom=main", f"--signal={blow}", unit())
            # A host on which the command takes long has it started anew before anything is read here.
            came = until(subscription, lambda item: isinstance(item, Stale), "stale")
            if not any(isinstance(item, Restarted) for item in came):
                until(subscription, lambda item: isinstance(item, Restarted), "restarted")
            until_fresh_scans(subscription)
        state, after, more = container.shown(unit(), "ActiveState", "MainPID", "NRestarts")
        assert (state, int(more)) == ("active", int(restarts) + 1)
        assert after != before
        assert ("Watchdog timeout" in container.journal(unit())) or blow == "KILL"

    def test_stop_ends_well_and_the_board_is_told(self, container: Container, truth: Path) -> None:
        with listening(container) as subscription:
            until_fresh_scans(subscription)
        container.run("systemctl", "stop", unit())
        assert container.shown(unit(), "Result", "ExecMainStatus", "NRestarts") == ["success", "0", "0"]
        until_s, n_lines = time.monotonic() + PATIENCE_S, -1
        while n_lines != (n_lines := len(truth.read_text().splitlines())):  # an emulator may write late
            assert time.monotonic() < until_s, "the board still scans"
            time.sleep(0.5)
        assert not os.path.lexists(container.seen(f"/run/tactiled/{LEFT}"))


def test_what_a_person_must_mend_is_not_tried_again(container: Container) -> None:
    configure(container, RIGHT, "rate_hz = nonsense\n")
    try:
        with pytest.raises(AssertionError, match="failed"):
            container.run("systemctl", "start", unit(RIGHT))
        shown = container.shown(unit(RIGHT), "ActiveState", "ExecMainStatus", "NRestarts")
        assert shown == ["failed", "2", "0"]
    finally:
        configure(container, RIGHT)
        container.run("systemctl", "reset-failed")


def test_a_board_without_configuration_is_skipped(container: Container) -> None:
    container.run("systemctl", "start", unit("OTHER"))
    assert container.shown(unit("OTHER"), "ActiveState", "Result") == ["inactive", "success"]


def test_two_instances_keep_their_own_directory(container: Container) -> None:
    with started(container, LEFT):
        with (
            started(container, RIGHT),
            listening(container, LEFT) as left,
            listening(container, RIGHT) as right,
        ):
            for serial, subscription in ((LEFT, left), (RIGHT, right)):
                items = until_fresh_scans(subscription)
                scans = [item for item in items if isinstance(item, Message) and item.topic == "scan"]
                assert {scan.board for scan in scans} == {serial}
        assert not os.path.lexists(container.seen(f"/run/tactiled/{RIGHT}"))
        with listening(container, LEFT) as left:  # a new connection: the socket's file is still there
            until_fresh_scans(left)


def test_one_unit_reads_all_boards_and_the_instances_are_skipped(container: Container) -> None:
    for serial in PORTS:
        (container.root / f"var/lib/tactiled/{serial}").mkdir(parents=True, exist_ok=True)
        (container.root / f"etc/tactiled/{serial}.toml").write_text(
            f'[port]\nurl = "/dev/tactiled-{serial}"\n[session]\nboard_serial = "{serial}"\n'
        )
    container.run("systemctl", "enable", "tactiled.service")
    try:
        with board(container, LEFT), board(container, RIGHT):
            container.run("systemctl", "start", "tactiled.service")
            with Subscription(f"ipc://{container.seen('/run/tactiled/all/events.ipc')}") as subscription:
                missing = set(PORTS)

                def is_last(item: Item) -> bool:
                    if isinstance(item, Message) and item.topic == "scan":
                        missing.discard(item.board)
                    return not missing

                until(subscription, is_last, "scans of both boards")
            wait_until(
                lambda: container.shown("tactiled.service", "StatusText") == ["2 of 2 boards fresh"],
                "the line of status", PATIENCE_S,
            )  # fmt: skip
            container.run("systemctl", "start", unit())
            assert container.shown(unit(), "ActiveState", "Result") == ["inactive", "success"]
        wait_until(
            lambda: container.shown("tactiled.service", "StatusText")[0].startswith("0 of 2 boards fresh"),
            "the boards are gone", PATIENCE_S,
        )  # fmt: skip
        assert container.shown("tactiled.service", "ActiveState", "NRestarts") == ["active", "0"]
    except BaseException:
        print(container.journal("tactiled.service"))  # pytest shows it with the failure
        raise
    finally:
        container.run("systemctl", "disable", "--now", "tactiled.service")
        container.run("systemctl", "reset-failed")
        for serial in PORTS:
            configure(container, serial)


def test_it_records_where_the_configuration_says(container: Container) -> None:
    """The directory that the shipped configuration names is writable inside the hardening."""
    configure(container, LEFT, f'[record]\ndirectory = "/var/lib/tactiled/{LEFT}"\nmin_free_mb = 1.0\n')
    try:
        with started(container), listening(container) as subscription:
            until_fresh_scans(subscription)
            container.run("systemctl", "stop", unit())
            (recording,) = (container.root / f"var/lib/tactiled/{LEFT}").glob("*.mcap")
            path = f"/var/lib/tactiled/{LEFT}/{recording.name}"
            container.run("/opt/tactiled/bin/tactiled", "replay", "--verify", path)
    finally:
        configure(container, LEFT)


def test_upgrade_while_running(container: Container) -> None:
    """Files are replaced under a running daemon, which goes on, and a restart brings the new version.

    A subscriber from before the restart sees the new run and goes on by itself. This test comes last in the
    module: the new version stays in the container.
    """
    with started(container), listening(container) as subscription:
        until_fresh_scans(subscription)
        (before,) = container.shown(unit(), "MainPID")
        upgrade(container, NEW)
        assert container.shown(unit(), "MainPID", "NRestarts") == [before, "0"]
        container.run("systemctl", "restart", unit())
        until(subscription, lambda item: isinstance(item, Restarted), "restarted")
        until_fresh_scans(subscription)
        shown = container.run("/opt/tactiled/bin/pip", "show", "tactiled")
        assert f"Version: {NEW}" in shown
        assert container.shown(unit(), "Result", "NRestarts") == ["success", "0"]
