"""A bar on a terminal, one plain line elsewhere, and nothing of either on standard output."""

import io
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from tactiled.progress import ProgressBar, tell


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_has_a_bar_with_what_is_done_and_its_share() -> None:
    terminal = _Terminal()
    with ProgressBar("bench slip", None, terminal=terminal) as bar:
        bar.begin(8.0)
        bar.advance("noise", 2.0)
        bar.reach(6.0)
    assert "bench slip: noise" in terminal.getvalue()
    assert "75%" in terminal.getvalue()


def test_elsewhere_there_is_one_plain_line() -> None:
    file = io.StringIO()
    with ProgressBar("export a.csv", terminal=file) as bar:
        for _ in range(100):
            bar.advance("scans", 0.01)
    assert file.getvalue() == "export a.csv ...\n"


def test_without_a_terminal_rich_is_not_imported() -> None:
    script = (
        "import sys; from tactiled.progress import ProgressBar\n"
        "with ProgressBar('x') as bar: bar.reach(0.5)\n"
        "print('rich' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("False\n", "x ...\n")


def test_no_bar_is_drawn_into_lines_on_the_same_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stdout", _Terminal())
    with ProgressBar("replay", writes_lines=True, terminal=terminal) as bar:
        bar.reach(0.5)
    assert terminal.getvalue() == "replay ...\n"


def test_a_verb_draws_its_bar_on_standard_error_and_its_lines_on_standard_output(tmp_path: Path) -> None:
    """Standard error is a pseudo-terminal here, and a log of 100 s is enough for a bar in between."""
    rows = "".join(f"{k / 100}," + ",".join(["0"] * 36) + "\n" for k in range(10_000))
    (tmp_path / "log.csv").write_text("time_s," + ",".join(f"c{k}" for k in range(36)) + "\n" + rows)
    ours, theirs = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "tactiled", "detect", "log.csv"], cwd=tmp_path, stdout=subprocess.PIPE,
            stderr=theirs, check=True, timeout=60,
        )  # fmt: skip
        os.set_blocking(ours, False)
        shown = os.read(ours, 1 << 16).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    assert "detect log.csv" in shown
    assert "%" in shown
    assert b"\x1b" not in done.stdout


def test_long_lines_are_wrapped_in_a_terminal_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    words = "a/path-that-is-long: " + "twelve words " * 9 + "\n\n  [table]\nshort = 1"
    plain = io.StringIO()
    monkeypatch.setattr(sys, "stderr", plain)
    tell(words)
    assert plain.getvalue() == f"{words}\n"
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        tell(words)
        shown = os.read(ours, 1 << 16).decode().splitlines()
    os.close(ours)
    assert max(map(len, shown)) <= 80
    assert [line.startswith("    ") for line in shown] == [False, True, False, False, False]
    assert shown[-3:] == ["", "  [table]", "short = 1"]
