"""Tables of the slip bench, from events made by hand and from short scenes."""

import pytest
from bench.slip.scenes import NOISES_V, RATE_HZ

from bench.report import BenchOptions
from bench.slip import bench as slip_bench
from bench.slip import minutes
from bench.slip.bench import bench_slip, read_scene
from bench.slip.cases import CaseEvents, from_world, run_case
from bench.worlds.laws import draw_worlds
from tactiled.progress import ProgressBar


@pytest.fixture(scope="module")
def slide() -> list[CaseEvents]:
    """A slide, read at every noise."""
    return read_scene("20 mm/s", 1)


@pytest.fixture(scope="module")
def taps() -> list[CaseEvents]:
    """Taps without slip, read at every noise."""
    return read_scene("taps", 1)


def test_a_scene_is_a_case_at_every_noise(slide: list[CaseEvents], taps: list[CaseEvents]) -> None:
    assert [one.case.group for one in slide] == [f"{1e3 * noise_v:g} mV" for noise_v in NOISES_V]
    assert all(one.case.slips for one in slide)
    assert not any(one.case.slips for one in taps)
    for one in slide:
        case = one.case
        assert case.shear_s < case.tenth_s < case.gross_s < case.gross_end_s
        assert case.utilisation_at(case.tenth_s + 0.02) > 0.1
        assert case.utilisation_at(case.gross_s + 0.05) > 0.9
        assert case.nothing[: int(case.shear_s * RATE_HZ)].all()


def test_the_bench_prints_all_tables(
    slide: list[CaseEvents], taps: list[CaseEvents], monkeypatch: pytest.MonkeyPatch
) -> None:
    world = next(one for one in draw_worlds(range(20_000, 20_012)) if one.slips)
    worlds = [run_case(from_world(world))]
    monkeypatch.setattr(slip_bench, "executor", _InPlace)
    monkeypatch.setattr(slip_bench, "SCENES", {"20 mm/s": None})
    monkeypatch.setattr(slip_bench, "read_worlds", lambda _: worlds)
    monkeypatch.setattr(slip_bench, "read_scene", lambda *_: [*slide, *taps])
    monkeypatch.setattr(slip_bench, "N_QUICK_GRATINGS", 1)
    monkeypatch.setattr(slip_bench, "N_QUICK_SLIDES", 1)
    monkeypatch.setattr(slip_bench, "N_QUICK_RESTS", 1)
    monkeypatch.setattr(minutes, "_LENGTH_S", 3.0)  # of a minute
    text = "\n".join(bench_slip(ProgressBar("slips", None), BenchOptions(quick=True)))
    assert text.count("| question") == 1 + len(NOISES_V)
    assert "Random worlds: 4 cases, 4 with gross slip." in text  # one of each batch
    assert "Slides and rests of a minute (seeds 7000..7001" in text


class _InPlace:
    """Executor that runs its jobs in this process."""

    def __init__(self, *_: object) -> None: ...

    def __enter__(self) -> "_InPlace":
        return self

    def __exit__(self, *_: object) -> None: ...

    map = staticmethod(map)
