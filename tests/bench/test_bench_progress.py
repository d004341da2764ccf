"""A bar on a terminal, lines elsewhere, and the time that is left."""

import io
import itertools

from tactiled.bench.progress import Progress


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_has_one_line_that_is_renewed() -> None:
    terminal, lines = _Terminal(), list[str]()
    progress = Progress(lines.append, 4, terminal=terminal, clock=itertools.count(0.0, 30.0).__next__)
    progress.advance("slips")
    assert terminal.getvalue().startswith("\r[########....")
    assert terminal.getvalue().endswith("25 %  slips, 1 min 30 s left")
    progress.advance("slips", 3)
    assert terminal.getvalue().rstrip().endswith("100 %  slips")  # nothing is left
    progress.close()
    assert not terminal.getvalue().split("\r")[-2].strip()
    assert "\n" not in terminal.getvalue()
    assert not lines


def test_elsewhere_every_tenth_has_a_line() -> None:
    elsewhere, lines = io.StringIO(), list[str]()
    progress = Progress(lines.append, 100, terminal=elsewhere, clock=itertools.count(0.0, 0.1).__next__)
    for _ in range(100):
        progress.advance("scenes")
    progress.close()
    assert [line.split(" %")[0] for line in lines] == [f"{n}" for n in range(10, 101, 10)]
    assert lines[4] == "50 %  scenes, 5 s left"
    assert not elsewhere.getvalue()
