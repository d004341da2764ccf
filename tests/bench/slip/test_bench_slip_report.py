"""Tables and picture of the slip bench, from events made by hand and from short scenes."""

from pathlib import Path

import pytest

from bench.report import BenchOptions
from bench.slip import bench as slip_bench
from bench.slip.bench import bench_slip, read_scene
from bench.slip.cases import from_world
from bench.slip.cost import DETECTORS, DetectorCost, cost_table
from bench.slip.faults import FaultEvents, Stream
from bench.slip.replay import NAMES, CaseEvents, run_case, run_stream
from bench.slip.scenes import ARRAY, NOISES_V, RATE_HZ, play
from bench.slip.tables import QUESTIONS, fault_table, quiet_table, resting_table, settings_table, slips_table
from bench.worlds.laws import draw_worlds
from tactiled.emulator.scene.families import QUIET
from tactiled.progress import ProgressBar
from tactiled.samples.block import Gap


@pytest.fixture(scope="module")
def slide() -> list[CaseEvents]:
    """A slide, read at every noise."""
    return read_scene("20 mm/s", 1)


@pytest.fixture(scope="module")
def taps() -> list[CaseEvents]:
    """Taps without slip, read at every noise."""
    return read_scene("taps", 1)


def cells(text: str, row: str) -> list[str]:
    """Cells of a row behind the first."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {row} "))
    return [cell.strip() for cell in line.split("|")[2:-1]]


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


def test_every_table_has_a_column_for_each_setting(slide: list[CaseEvents], taps: list[CaseEvents]) -> None:
    text = settings_table([slide[0], taps[0]])
    assert all(len(cells(text, question)) == len(NAMES) for question in QUESTIONS)
    assert cells(text, "gross reported in 300 ms")[1].endswith("of 1")
    assert cells(text, "rests called gross")[1].endswith("of 1")
    by_family = cells(slips_table(slide), "20 mm/s")
    assert by_family[0].endswith("of 1")
    assert by_family[0].count("/") == len(NOISES_V) - 1
    quiet = quiet_table(taps)
    hours = float(cells(quiet, "taps")[0])
    assert hours == pytest.approx(sum(len(one.case.block) for one in taps) / RATE_HZ / 3600, abs=0.005)
    assert cells(quiet, "taps") == cells(quiet, "all")
    assert resting_table(slide).count("| -") == 6 * len(NAMES)  # no such load was read


def test_a_gap_reaches_every_detector_and_valid_onsets_are_counted() -> None:
    played = play("taps", QUIET["taps"], 1)
    whole = played.read(NOISES_V[0], draw=0)
    stream: Stream = [whole[:300], Gap(1, "missing", 301), whole[301:]]
    found = run_stream(ARRAY, stream)
    assert tuple(found) == NAMES
    text = fault_table([FaultEvents("gaps", stream, found), FaultEvents("gaps", stream, found)])
    onsets = [e for e in found[NAMES[0]] if e.state == "onset" and e.valid]
    row = cells(text, "gaps")
    assert row[0] == f"{2 * (len(whole) - 1) / RATE_HZ / 60:.1f}"
    assert row[1].split(",")[0] == f"{2 * len(onsets)}"


def test_the_bench_prints_all_tables_and_draws(
    slide: list[CaseEvents], taps: list[CaseEvents], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = next(one for one in draw_worlds(range(20_000, 20_012)) if one.slips)
    worlds = [run_case(from_world(world))]
    fault = FaultEvents("none", [slide[0].case.block], dict.fromkeys(NAMES, ()))
    costs = {name: DetectorCost(30.0, 150.0, 60.0) for name in DETECTORS}
    monkeypatch.setattr(slip_bench, "executor", _InPlace)
    monkeypatch.setattr(slip_bench, "SCENES", {"20 mm/s": None})
    monkeypatch.setattr(slip_bench, "read_worlds", lambda _: worlds)
    monkeypatch.setattr(slip_bench, "read_scene", lambda *_: [*slide, *taps])
    monkeypatch.setattr(slip_bench, "read_faults", lambda _: [fault])
    monkeypatch.setattr(slip_bench, "detector_costs", lambda: costs)
    options = BenchOptions(quick=True, plot=tmp_path / "slip.png")
    report = bench_slip(ProgressBar("slips", None), options)
    report.write(options)
    assert report.text.count("| question") == 2 + len(NOISES_V)  # the first is in short
    assert "In short: Random worlds; Families at 0.3 mV; Families at 3 mV." in report.text
    assert "Random worlds: 4 cases, 4 with gross slip." in report.text  # one of each batch
    assert cost_table(costs) in report.text
    assert (tmp_path / "slip.png").stat().st_size > 10_000


class _InPlace:
    """Executor that runs its jobs in this process."""

    def __init__(self, *_: object) -> None: ...

    def __enter__(self) -> "_InPlace":
        return self

    def __exit__(self, *_: object) -> None: ...

    map = staticmethod(map)
