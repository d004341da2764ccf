"""Tables of the slip bench, from short worlds."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from bench.report import BenchOptions
from bench.slip import bench as slip_bench
from bench.slip import minutes
from bench.slip.bench import bench_slip
from bench.slip.cases import NAMES, Reported, run_case
from bench.worlds.generators import draw
from tactiled.progress import ProgressBar


@pytest.fixture(scope="module")
def slide() -> dict[str, Reported]:
    """A slide of the emulator's skin."""
    worlds = draw("plates", range(10, 16), 0.1, ("slide",))
    return next(run_case(one) for one in worlds if one.slips)


def test_a_world_is_a_case_of_its_first_slip(slide: dict[str, Reported]) -> None:
    assert tuple(slide) == NAMES
    case = slide["balanced"].case
    assert (case.slips, case.is_falling) == (True, False)
    assert case.tenth_s <= case.gross_s < case.gross_end_s
    assert case.utilisation[round((case.gross_s + 0.05) * case.block.rate_hz)] > 0.9
    assert case.nothing[0]
    assert not case.nothing[round(case.gross_s * case.block.rate_hz) + 1]


def test_the_bench_prints_all_tables(slide: dict[str, Reported], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slip_bench, "executor", lambda *_: nullcontext(SimpleNamespace(map=map)))
    monkeypatch.setattr(slip_bench, "read_laws", lambda _: [slide])
    monkeypatch.setattr(slip_bench, "read_plates", lambda _: [slide])
    monkeypatch.setattr(slip_bench, "QUICK", (48, 1, 1, 1))
    monkeypatch.setattr(minutes, "_LENGTH_S", 3.0)  # of a minute
    text = "\n".join(bench_slip(ProgressBar("slips", None), BenchOptions(quick=True)))
    assert text.count("| question") == 2
    assert "Worlds of plates: 4 cases, 4 with gross slip." in text  # one of each batch
    assert "Slides and rests of a minute (seeds 7000..7001" in text
