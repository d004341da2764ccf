"""Readers of formats of others, rules that see nothing of what they judge, and the catalogue."""

import bz2
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.__main__ import bench
from bench.recordings import ours
from bench.recordings.bench import _AIMS, Contacts, Decisions, Errors, Found, Periods, check_range
from bench.recordings.catalogue import how_to_get, sources
from bench.recordings.log import Log, numbered, pressure_profile, rows, tensor
from bench.recordings.rules import (
    agreement,
    by_best_of_others,
    by_threshold,
    centre_change,
    contact_by_norm,
    load_fall,
    median_change,
    ridge_of_resistance,
    shape_change,
    strongest_line_hz,
)
from bench.recordings.sources import READERS, uskin, uskin_drops
from tactiled.array import ArrayFile, TaxelChannel, build
from tactiled.errors import DataError


def log(label: bool = False, group: str = "cup", change: float = 0.0, **more: object) -> Log:
    time_s = np.arange(300) / 100.0
    readings = np.repeat(change * np.clip(time_s - 1.0, 0, 1)[:, np.newaxis], 4, axis=1)
    return Log("log", group, time_s, readings, label=label, **more)  # type: ignore[arg-type]


def test_every_source_has_a_reader_and_an_array_that_fits_the_detectors() -> None:
    found = {source.name: source for source in sources()}
    assert set(found) == set(READERS)
    assert found["SDH-2"].array.n_channels == 486
    commands = how_to_get(found.values())
    assert len(commands) == len({source.address for source in found.values()})
    assert all(len(source.commit) == 40 and source.commit in " ".join(commands) for source in found.values())


def test_readings_beyond_the_range_of_the_catalogue_are_refused() -> None:
    """They would count as saturated, and the bench would score a sensor that nobody has."""
    source = sources()[0]
    edges = Log("edges", "", np.arange(2.0), np.array([[source.array.low], [source.array.high]]))
    check_range(source, [edges])
    with pytest.raises(DataError, match=f"{source.name}: readings are .* beyond `range`"):
        check_range(source, [edges, replace(edges, readings=edges.readings + 1.0)])


def test_tables_with_headers_and_trailing_commas(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time, a, b,\n1,2,3,\n4,-nan,x,\n")
    np.testing.assert_equal(rows(path, header=True), [[1, 2, 3], [4, np.nan, np.nan]])
    for name in ("seq_10", "seq_2"):
        (tmp_path / f"{name}.pt").touch()
    assert [found.stem for found in numbered(tmp_path, "*.pt")] == ["seq_2", "seq_10"]


def test_a_tensor_is_read_without_unpickling(tmp_path: Path) -> None:
    path = tmp_path / "seq.pt"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("seq/data.pkl", b"cos\nsystem\n(S'false'\ntR.")
        file.writestr("seq/data/0", np.arange(6, dtype="<f4").tobytes())
    np.testing.assert_array_equal(tensor(path, 3), [[0, 1, 2], [3, 4, 5]])
    with pytest.raises(DataError, match="6 values"):
        tensor(path, 4)


def test_a_pressure_profile_has_runs_of_zeros(tmp_path: Path) -> None:
    packed = np.array([-2.0, 7.0, 9.0, -1.0], dtype=">f4").tobytes().hex()
    frame = f"<frame><time_stamp>250</time_stamp><frame_data>{packed}</frame_data></frame>"
    document = f"<root><data>{frame}</data></root>"
    path = tmp_path / "grasp.dsa"
    path.write_bytes(bz2.compress(document.encode()))
    time_s, cells = pressure_profile(path)
    np.testing.assert_array_equal(time_s, [0.25])
    np.testing.assert_array_equal(cells, [[0, 0, 7, 9, 0]])


def test_a_threshold_comes_from_other_groups_alone() -> None:
    logs = [log(True, "cup", 9.0), log(False, "cup", 1.0), log(True, "pen", 10.0), log(False, "pen", 2.0)]
    assert by_threshold(logs, median_change) == [True, False, True, False]
    alone = [log(True, "cup", 5.0), log(False, "cup"), log(True, "pen", 10.0), log(False, "pen", 7.0)]
    assert by_threshold(alone, median_change)[0] is False  # 5 is below what the others say


def test_a_choice_is_made_on_other_groups_alone() -> None:
    logs = [log(True, "cup"), log(False, "cup"), log(True, "pen"), log(False, "pen")]
    said = np.array([[1, 0, 0, 0], [1, 1, 1, 0]], dtype=np.bool_)
    # On the pen the second choice is right twice; on the cup the first one is.
    assert by_best_of_others(logs, said) == [True, True, False, False]


def test_a_limit_of_growth_is_one_of_load_that_moves() -> None:
    pad = build(ArrayFile(name="pad", taxel_count=8, taxel_channels=[TaxelChannel(name="N", kind="normal")]))
    time_s = np.arange(900)[:, np.newaxis] / 100.0
    rng = np.random.default_rng(0)
    moves = 1.0 + 0.1 * np.where(np.arange(8) < 4, -1, 1) * np.clip((time_s - 6.0) / 0.3, 0, 1)
    readings = np.clip(time_s - 1.0, 0, 1) * moves + 1e-3 * rng.standard_normal((900, 8))
    said = ours.slips_by_growth([Log("moves", "pen", time_s[:, 0], readings)], pad, [1e2, 1e9])
    assert said.tolist() == [[True], [False]]


def test_the_rules_find_what_they_name() -> None:
    time_s = np.arange(700) / 35.0
    rng = np.random.default_rng(0)
    ripple = np.cos(2 * np.pi * 2.5 * time_s[:, np.newaxis] + np.arange(8))
    noise = rng.standard_normal((700, 8))
    slide = Log("slide", "ridges", time_s, 5 * ripple + noise, period_mm=4.0, speed_mm_s=10.0)
    assert 10.0 / strongest_line_hz(slide) == pytest.approx(4.0, rel=0.01)
    assert strongest_line_hz(Log("flat", "plate", time_s, noise)) == 0.0
    cells = np.zeros((40, 12))
    cells[np.arange(40), 4 + np.minimum(np.arange(40) // 10, 3)] = 100.0
    assert centre_change(Log("moves", "pen", time_s[:40], cells, pads=((3, 4, 0),))) == 1.0


def presses(size: float = 10.0) -> Log:
    """Return six presses of one to six newtons on a resistor of `size` kOhm."""
    time_s = np.arange(1200) / 100.0
    fz_n = np.where(time_s % 2 > 1, 1 + time_s // 2, 0.0)
    forces = np.stack([np.full(1200, np.nan), np.full(1200, np.nan), fz_n], axis=1)
    return Log("presses", "foil", time_s, size / (1.0 + fz_n[:, np.newaxis]), forces=forces)


def test_contact_is_compared_with_the_force() -> None:
    one = presses()
    assert agreement(one.is_pressed, one) == 1.0
    assert agreement(np.ones(1200, dtype=np.bool_), one) == 0.5
    assert contact_by_norm([one, presses(), presses(11.0)]) == [1.0, 1.0, 1.0]
    rough = replace(presses(1e3), readings=presses(1e3).readings + np.sin(one.time_s[:, np.newaxis] * 9))
    by_the_other_level = contact_by_norm([rough, presses(0.1)])
    assert by_the_other_level[0] < 0.6
    assert by_the_other_level[1] == 0.5
    forces = one.forces
    assert forces is not None
    light = replace(one, forces=np.where(forces == 1.0, 0.1, forces))  # 1.7 % of the range: neither
    assert agreement(forces[:, 2] > 0, light) == 1.0
    assert str(Contacts([0.5, 0.75])) == "0.50; 0.75"
    assert str(Contacts([0.9, 0.1, 0.2, 0.3, 0.4, 0.5])) == "0.30, from 0.10 to 0.90"  # the lower median


def test_a_resistance_tells_the_force_by_its_inverse() -> None:
    one = presses()
    assert one.forces is not None
    reference = np.pad(np.nan_to_num(one.forces), ((0, 0), (0, 3)))
    assert ridge_of_resistance(one, one.time_s, reference, [2]) == pytest.approx([0.0], abs=1e-3)


def test_a_load_that_falls_away() -> None:
    held = np.clip(np.arange(300)[:, np.newaxis] / 50.0 - 1.0, 0.0, 1.0) * [3.0, 4.0]
    dropped = np.where(np.arange(300)[:, np.newaxis] < 200, held, 0.0)
    time_s = np.arange(300) / 100.0
    assert load_fall(Log("held", "box", time_s, held)) == 0.0
    assert load_fall(Log("dropped", "box", time_s, dropped)) == 1.0


def test_a_load_that_moves_changes_the_shape_and_one_that_grows_does_not() -> None:
    press = log(change=5.0)
    moved = press.readings + np.outer(np.clip(press.time_s - 2.0, 0, 0.5), [4.0, -4.0, 4.0, -4.0])
    assert shape_change(press) == pytest.approx(0.0, abs=1e-9)
    assert shape_change(replace(press, readings=moved)) > 0.3


def test_a_box_slips_where_a_camera_in_the_hand_sees_it_turn(tmp_path: Path) -> None:
    """Runs of 10 s: held from 2 s on, lifted from 4 s on; it turns from 6 s to 7 s. Outliers do not count."""
    time_s = np.linspace(0.0, 10.0, 400)
    readings = np.outer(np.clip(time_s - 2.0, 0, 1), np.tile([0.0, 0.0, 900.0], 16)) + 30000.0
    hand = np.zeros((400, 22))
    hand[:, 17] = 0.1 * np.clip(time_s - 4.0, 0, 1)
    rng = np.random.default_rng(0)
    for name, turn_deg in (("rests", 1.0), ("between", 7.0), ("slips", -20.0), ("unseen", 0.0)):
        half = np.deg2rad(turn_deg * np.clip(time_s - 6.0, 0, 1)) / 2
        seen = np.zeros((400, 14))
        if name != "unseen":
            seen[:, :3] = [0.0, 0.0, 0.2] + 1e-4 * rng.normal(size=(400, 3))
            seen[:, 5], seen[:, 6] = np.sin(half), np.cos(half)
            seen[::2, 3:7] *= -1.0
            seen[::50, :7] = [9.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
        run = tmp_path / "train" / f"data_sample_{name}"
        run.mkdir(parents=True)
        for file, table in (("xela_sensor1", readings), ("xela_sensor2", readings), ("robot_state", hand)):
            np.savetxt(run / f"{file}.csv", table, delimiter=",", header="x", comments="")
        np.savetxt(run / "marker.csv", seen, delimiter=",", header="x", comments="")
        about = "7,0,2021-11-24 15:19:09.0,2021-11-24 15:19:19.0"
        (run / "meta_data.csv").write_text(f"object_name,dropped,start_time,stop_time\n{about}\n")
    found = {one.name.removeprefix("data_sample_"): one.label for one in uskin(tmp_path)}
    assert found == {"rests": False, "slips": True}
    assert [one.label for one in uskin_drops(tmp_path)] == [False] * 4


def test_a_contact_that_is_over_was_lost() -> None:
    array = build(
        ArrayFile(
            name="cells",
            unit="count",
            range=(0, 4095),
            zero=50.0,
            taxel_count=4,
            taxel_channels=(TaxelChannel(name="N", kind="normal"),),
        )
    )
    time_s = np.arange(500) / 100.0
    load = np.where(time_s > 1.0, 500.0, 0.0)
    dropped = np.where(time_s < 4.0, load, 0.0)
    noise = np.random.default_rng(0).normal(size=(500, 4)) + 50.0
    courses = (load, dropped, 0.0 * load)
    said = [ours.loses(Log("", "", time_s, np.rint(one[:, np.newaxis] + noise)), array) for one in courses]
    assert said == [False, True, False]


def test_counts_name_what_was_asked() -> None:
    grating = Log("a", "b", np.arange(3.0), np.zeros((3, 1)), period_mm=4.0)
    assert str(Periods.count([grating, grating, grating], [4.1, 9.0, 0.0])) == "1 of 3 right, 1 wrong"
    assert str(Periods.count([log(), log()], [4.1, 0.0])) == "1 of 2 with a period"
    assert str(Decisions.count([log(True), log(), log()], [True, True, False])) == "1 of 1, 1 of 2 false"


def test_a_force_that_is_refused_meets_no_aim() -> None:
    """Errors of the other logs say nothing of it, and of no log they are all as small as one likes."""
    small, large = np.full(1, 0.01), np.full(1, 0.02)
    aims = {source: is_met for _, _, source, question, is_met in _AIMS if question in ("force", "poses")}
    for name, is_met in aims.items():
        source = next(one for one in sources() if one.name == name)
        good = Errors([small], [np.full(1, 0.9)])
        one = Found(source, "force", 1, good, Errors([large]), Errors([large]))
        assert is_met(one)
        nothing = Errors([])
        assert not is_met(one._replace(ours=replace(good, n_refused=1)))
        assert not is_met(one._replace(ours=replace(nothing, n_refused=1), rule=nothing, trees=nothing))


def test_without_data_the_command_says_how_to_get_them(tmp_path: Path) -> None:
    result = CliRunner().invoke(bench, ["recordings"])
    assert result.exit_code == 2
    assert "git clone" in result.output
    assert CliRunner().invoke(bench, ["slip", "--data", str(tmp_path)]).exit_code == 2
