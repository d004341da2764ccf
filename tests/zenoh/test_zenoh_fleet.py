"""The list of boards from replies of hosts."""

import json
import socket
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from prometheus_client.parser import text_string_to_metric_families

from tactiled.commands.fleet import fleet
from tactiled.errors import UnavailableError
from tactiled.zenoh.fleet import FleetList, FleetMetrics, FleetRow, draw_table, rows_of

NOW = 1000.0
STATUS: dict[str, Any] = {
    "timestamp": NOW - 0.05, "state": "running", "valid": True, "reason": "", "warning": "noisy line",
    "age_s": 0.01, "scans": 999, "scans_missing": 1, "loss_known": True,
}  # fmt: skip


def reply(**messages: dict[str, Any]) -> dict[str, Any]:
    return {"messages": {f"tactile/B1/{topic}": message for topic, message in messages.items()}}


def arrived(**replies: Any) -> dict[str, tuple[Any, float]]:
    """Replies of hosts that came now."""
    return {host: (answer, NOW) for host, answer in replies.items()}


def test_a_row_has_what_the_messages_say() -> None:
    grip = {"state": "partial", "utilisation": 0.7, "timestamp": NOW - 0.02}
    disk = {"state": "recording", "free_mb": 120.0}
    [row] = rows_of("h", reply(status=STATUS, grip=grip, recording=disk, info={"firmware_version": "9"}), NOW)
    assert (row.host, row.board, row.state, row.valid) == ("h", "B1", "running", True)
    assert row.age_s == pytest.approx(0.06)
    assert (row.utilisation, row.loss_ppm, row.firmware, row.free_mb) == (0.7, 1000.0, "9", 120.0)
    assert row.reason == "noisy line"


def grip(state: str, age_s: float) -> dict[str, Any]:
    return {"state": state, "utilisation": 0.7, "timestamp": NOW - age_s}


@pytest.mark.parametrize(
    ("status", "others", "expected"),
    [
        # a status older than a second by either clock is silence
        *(({"timestamp": NOW - age_s}, {}, {"valid": True, "state": "running"}) for age_s in (0.95, -0.95)),
        *(({"timestamp": NOW - age_s}, {}, {"valid": False, "state": "silent"}) for age_s in (1.05, -1.05)),
        # numbers that are not known are shown as unknown
        ({"age_s": 1e9}, {}, {"age_s": -1.0}),  # before any scan
        ({"age_s": 0.0, "timestamp": NOW + 0.5}, {}, {"age_s": 0.0}),  # no negative age
        ({"loss_known": False}, {}, {"loss_ppm": -1.0}),
        ({"scans": 0, "scans_missing": 0}, {}, {"loss_ppm": -1.0}),
        ({"scans": 3, "scans_missing": 1}, {}, {"loss_ppm": 250_000.0}),
        ({"reason": "unplugged"}, {}, {"reason": "unplugged"}),
        ({"valid": 1}, {}, {"valid": False}),
        ({"valid": False, "state": "stalled"}, {}, {"valid": False, "state": "stalled"}),
        # a text of a host is short
        ({"warning": "x" * 10**6, "state": "y" * 10**6}, {}, {"reason": "x" * 200, "state": "y" * 200}),
        # utilisation is that of a contact of now
        ({}, {"grip": grip("none", 0.0)}, {"utilisation": -1.0}),
        ({}, {"grip": grip("partial", 0.9)}, {"utilisation": 0.7}),
        *(({}, {"grip": grip("partial", age_s)}, {"utilisation": -1.0}) for age_s in (1.1, -1.1)),
        # disk space is that of a recording
        ({}, {"recording": {"state": "off", "free_mb": 12_345.0}}, {"free_mb": -1.0}),
        ({}, {"recording": {"state": "no-room", "free_mb": 12_345.0}}, {"free_mb": 12_345.0}),
    ],
)
def test_fields_of_a_row(status: Any, others: Any, expected: dict[str, Any]) -> None:
    [row] = rows_of("h", reply(status=STATUS | status, **others), NOW)
    assert {name: getattr(row, name) for name in expected} == expected


@pytest.mark.parametrize("off_s", [-3.0, 3.0])
def test_clocks_that_differ_are_named(off_s: float) -> None:
    [row] = rows_of("h", reply(status=STATUS | {"timestamp": NOW - off_s, "warning": ""}), NOW)
    assert f"{off_s} s old" in row.reason
    assert "clocks" in row.reason


def test_what_cannot_be_read_is_silent_or_no_row() -> None:
    [row] = rows_of("h", reply(status={"timestamp": "x"}), NOW)
    assert (row.state, "cannot be read" in row.reason) == ("silent", True)
    deep: Any = 1
    for _ in range(1000):
        deep = [deep]
    [row] = rows_of("h", reply(status=STATUS | {"reason": deep}), NOW)
    assert row.state == "silent"
    messages = {"tactile/B1": STATUS, "a/b/c/d": STATUS, "tactile/B2/status": 3, "tactile/B3/status": STATUS}
    assert [row.board for row in rows_of("h", {"messages": messages}, NOW)] == ["B3"]


@pytest.mark.parametrize("answer", [None, {}, {"messages": 3}, [1]])
def test_a_host_without_an_answer_is_silent(answer: Any) -> None:
    [row] = rows_of("h", answer, NOW)
    assert (row.board, row.state, row.valid) == ("", "silent", False)


def test_the_time_before_a_board_said_its_name_is_no_board_of_its_own() -> None:
    unnamed = {"tactile/-/status": STATUS | {"timestamp": NOW - 50, "state": "syncing", "valid": False}}
    assert [row.board for row in rows_of("h", {"messages": unnamed}, NOW)] == ["-"]
    named = reply(status=STATUS)["messages"]
    assert [row.board for row in rows_of("h", {"messages": unnamed | named}, NOW)] == ["B1"]


@pytest.mark.parametrize(("serial", "shown"), [("B2", "B2"), ("B 3", "B-3"), ("", "-")])
def test_a_board_that_was_exchanged_has_no_row(serial: str, shown: str) -> None:
    messages = {f"tactile/{board}/status": STATUS for board in ("B1", shown)}
    assert [row.board for row in rows_of("h", {"messages": messages, "boards": [serial]}, NOW)] == [shown]


def test_a_robot_that_is_expected_and_never_came_is_missing() -> None:
    boards = FleetList("zenoh://127.0.0.1:7447/*", expected=("h", "lost", "h/B1", "h/B2"))
    states = {
        (row.host, row.board): (row.state, row.valid)
        for row in boards.update(arrived(h=reply(status=STATUS)))
    }
    assert states == {
        ("h", "B1"): ("running", True),
        ("h", "B2"): ("missing", False),
        ("lost", ""): ("missing", False),
    }
    came = boards.update(arrived(h=reply(status=STATUS), lost=reply(status=STATUS)))
    assert [(row.host, row.board, row.state) for row in came if row.state == "missing"] == [
        ("h", "B2", "missing")
    ]
    went = boards.update(arrived(h=reply(status=STATUS)))  # not missing twice
    assert [(row.host, row.state) for row in went if not row.valid] == [("h", "missing"), ("lost", "gone")]


FRESH = FleetRow("a", "B1", "running", valid=True)
SILENT = FleetRow("b", "", "silent", reason="its bridge is there, its daemon does not answer")


@pytest.mark.parametrize(
    ("rows", "code"), [([], 1), ([FRESH], 0), ([FRESH, FRESH], 0), ([SILENT], 1), ([FRESH, SILENT], 1)]
)
def test_once_says_by_its_exit_code_that_all_are_fresh(
    rows: list[FleetRow], code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FleetList, "ask", lambda _: rows)
    assert CliRunner().invoke(fleet, ["--once"]).exit_code == code
    assert CliRunner().invoke(fleet, ["--once", "--json"]).exit_code == code


@pytest.mark.parametrize("is_file", [False, True])
def test_expected_robots_of_the_command_line_are_missed(
    is_file: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tactiled.zenoh.fleet.states", lambda *_: {})
    listed = tmp_path / "robots.txt"
    listed.write_text("robot7  # hall 2\n\nrobot8/S1\n")
    names = ["--expect-file", str(listed)] if is_file else ["--expect", "robot7", "--expect", "robot8/S1"]
    done = CliRunner().invoke(fleet, ["--once", "--json", *names])
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [(row["host"], row["board"], row["state"]) for row in rows] == [
        ("robot7", "", "missing"),
        ("robot8", "S1", "missing"),
    ]
    assert done.exit_code == 1


def test_the_table_has_milliseconds_ppm_and_gigabytes_and_no_control_characters(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = [
        FleetRow("h", "B1", "running", True, 0.0123, 0.5, 2.25, "f9", "recording", 12_345.0),
        FleetRow(
            "h", "B2", "gone", age_s=0.0, utilisation=0.0, loss_ppm=0.0, recording="no-room", free_mb=0.0
        ),
        FleetRow("h", "B3", "silent", reason="\x1b["),
    ]
    draw_table(rows, clear=False)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines[1:4]] == [
        ["h", "B1", "running", "12", "0.50", "2.2", "f9", "12.3"],
        ["h", "B2", "gone", "0", "0.00", "0.0", "-", "0.0", "!"],
        ["h", "B3", "silent", "-", "-", "-", "-", "-", "?["],
    ]
    assert lines[4] == "1 of 3 boards fresh"


def test_a_narrow_terminal_shows_why_a_robot_is_not_fresh(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        FleetRow("robot-hall-07", "TS0001", "disconnected", reason="no port has this serial number"),
        FleetRow("robot-hall-08", "", "missing", reason="expected, and not on the network"),
    ]
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")  # 80 characters, and no styles
    draw_table(rows, clear=False)
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in lines)
    assert lines[1].split()[:3] == ["robot-hall-07", "TS0001", "disconnected"]
    assert "no port has this serial number" in lines[1]
    assert "expected, and not on the network" in lines[2]


@pytest.mark.parametrize("n_silent", [20, 1000])
def test_a_long_list_has_a_bounded_number_of_lines(n_silent: int, capsys: pytest.CaptureFixture[str]) -> None:
    replies: dict[str, Any] = {f"fresh{n:04}": reply(status=STATUS) for n in range(50)}
    replies |= {f"z{n:04}": None for n in range(n_silent)}
    rows = FleetList("zenoh://127.0.0.1:7447/*").update(arrived(**replies))
    draw_table(rows, clear=False)
    shown = capsys.readouterr().out.splitlines()
    assert shown[-1] == f"50 of {n_silent + 50} boards fresh"
    if n_silent == 20:
        assert len(shown) == 72
    else:
        assert len(shown) == 103
        assert shown[-2] == "and 950 more: 900 silent, 50 running"
        assert shown[1].startswith("z0000")


def page(port: int) -> dict[tuple[str, ...], float]:
    """Metrics of a page: name, host, board, and a further label where there is one."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
        text = answer.read().decode()
    return {
        (sample.name, labels.pop("host"), labels.pop("board"), *labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        for labels in [dict(sample.labels)]
    }


def test_prometheus_gets_all_boards_and_no_number_that_is_not_known() -> None:
    metrics = FleetMetrics()
    with metrics.serving(0) as port:
        assert page(port) == {}
        metrics.rows = [
            FleetRow(
                "a", 'B"1', "running", valid=True, age_s=0.02, utilisation=0.4, loss_ppm=20.0, firmware="9"
            ),
            FleetRow("b", "B1", "gone"),
        ]
        assert page(port) == {
            ("tactiled_state", "a", 'B"1', "running"): 1.0,
            ("tactiled_state", "b", "B1", "gone"): 1.0,
            ("tactiled_firmware", "a", 'B"1', "9"): 1.0,
            ("tactiled_valid", "a", 'B"1'): 1.0,
            ("tactiled_valid", "b", "B1"): 0.0,
            ("tactiled_scan_age_seconds", "a", 'B"1'): 0.02,
            ("tactiled_utilisation", "a", 'B"1'): 0.4,
            ("tactiled_missing_ratio", "a", 'B"1'): pytest.approx(2e-5),
        }
        metrics.lose()
        assert page(port) == {
            ("tactiled_state", "a", 'B"1', "silent"): 1.0,
            ("tactiled_state", "b", "B1", "silent"): 1.0,
            ("tactiled_valid", "a", 'B"1'): 0.0,
            ("tactiled_valid", "b", "B1"): 0.0,
        }
        with pytest.raises(UnavailableError, match=f"{port} cannot be had: .* in use"), metrics.serving(port):
            pass


def test_the_page_tells_that_the_router_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[Any] = [[FleetRow("a", "B1", "running", valid=True)], UnavailableError("no router")]
    pages: list[dict[tuple[str, ...], float]] = []

    def ask(_: FleetList) -> list[FleetRow]:
        if pages or len(answers) < 2:
            pages.append(page(port))
        if not answers:
            raise KeyboardInterrupt
        if isinstance(answer := answers.pop(0), Exception):
            raise answer
        return list(answer)

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = int(server.getsockname()[1])
    monkeypatch.setattr(FleetList, "ask", ask)
    CliRunner().invoke(fleet, ["--serve", f"{port}", "--every", "0.5", "--json"])
    assert [shown["tactiled_valid", "a", "B1"] for shown in pages] == [1.0, 0.0]


def test_hosts_and_boards_that_went_are_gone_until_they_return() -> None:
    boards = FleetList("zenoh://127.0.0.1:7447/*")
    two = {"messages": {f"tactile/{board}/status": STATUS for board in ("B1", "B2")}}

    def seen(replies: dict[str, Any]) -> list[tuple[str, str, str]]:
        return [(row.host, row.board, row.state) for row in boards.update(arrived(**replies))]

    running = [("a", "B1", "running"), ("a", "B2", "running")]
    assert seen({"b": None, "a": two}) == [*running, ("b", "", "silent")]
    assert seen({"a": two}) == [*running, ("b", "", "gone")]
    assert seen({"a": two, "b": reply(status=STATUS)}) == [*running, ("b", "B1", "running")]
    assert seen({"a": reply(status=STATUS), "b": None}) == [
        ("a", "B1", "running"), ("a", "B2", "gone"), ("b", "", "silent"), ("b", "B1", "gone")
    ]  # fmt: skip
