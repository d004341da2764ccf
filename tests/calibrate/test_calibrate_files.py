"""Files of a calibration: from an emulated rig to forces, and what is said of bad ones."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tactiled.calibrate.run import read_reference
from tactiled.cli.entry import cli
from tactiled.errors import ConfigError, DataError
from tactiled.force.calibration import load_calibration
from tactiled.scan_log import read_log

GOOD = "time_s,fz_n\n" + "".join(f"{0.1 * k:.1f},{k % 7}\n" for k in range(40))


def test_from_an_emulated_rig_to_forces(tmp_path: Path) -> None:
    rig, mine = tmp_path / "rig", tmp_path / "mine.toml"
    runner = CliRunner()
    assert runner.invoke(cli, ["emulate", "--rig", str(rig), "--seed", "3", "--rig-s", "25"]).exit_code == 0
    found = runner.invoke(
        cli,
        ["calibrate", f"{rig}/log.npz", "--reference", f"{rig}/reference.csv", "-o", str(mine), "--plot",
         str(tmp_path / "mine.png")],
    )  # fmt: skip
    assert found.exit_code == 0, found.output
    numbers = json.loads(found.stdout)
    assert numbers["model"] == "pairs"
    assert numbers["rms"]["fz_n"] < numbers["rms_of_ridge_with_squares"]["fz_n"]
    assert "clock of the reference" in found.stderr
    assert (tmp_path / "mine.png").stat().st_size > 10_000
    detected = runner.invoke(
        cli,
        ["detect", f"{rig}/test.npz", "--calibration", str(mine), "--only", "force", "--force-hz", "2"],
    )
    lines = [json.loads(line) for line in detected.stdout.splitlines()]
    assert len(lines) == 120
    assert {line["calibration"] for line in lines} == {"mine"}
    assert max(line["fz_n"] for line in lines) > 5.0


def test_a_calibration_needs_a_reference_or_the_guide(tmp_path: Path) -> None:
    (tmp_path / "log.npz").touch()
    said = CliRunner().invoke(cli, ["calibrate", str(tmp_path / "log.npz")])
    assert said.exit_code == 2
    assert "--guide" in said.output


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,fz\n1,2\n", "the header needs at least one of fx_n, .*; it has 'time_s', 'fz'"),
        ("t,fz_n\n1,2\n", "lacks the column time_s"),
        (GOOD.replace("fz_n", "tx_nmm"), "needs a force: at least one of fx_n, fy_n, fz_n"),
        (GOOD.replace("0.3,3", "0.3,3,1"), "line 5 has 3 cells"),
        (GOOD.replace("0.3,3", "0.3,three"), "'three' is not a number"),
        (GOOD.replace("0.1,1", "0.1,").replace("0.3,3", "0.9,3"), "times do not grow at row 5"),
        (GOOD.replace("0.3,3", "0.3," + 9000 * "x"), "'x{60}'... is not a number"),
        ("time_s,t\x1b[2J\n1,2\n", r"it has 'time_s', 't\\x1b\[2J'"),
        ("time_s,fz_n\n1.0,2\n", "at least 20"),
    ],
)
def test_a_bad_reference_is_refused_with_its_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "ft.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=says):
        read_reference(path)


def test_rows_with_holes_are_left_out_and_missing_columns_stay_unknown(tmp_path: Path) -> None:
    path = tmp_path / "ft.csv"
    path.write_text(GOOD.replace("0.3,3\n", "0.3,\n"))
    table = read_reference(path)
    assert len(table.time_s) == 39
    assert table.outputs == [2]


def test_a_reference_of_poses_needs_no_times_and_infinities_are_no_forces(tmp_path: Path) -> None:
    path = tmp_path / "ft.csv"
    path.write_text("fz_n,fx_n\n" + "".join(f"{k},inf\n" for k in range(40)))
    table = read_reference(path, are_poses=True)
    assert table.time_s.tolist() == list(range(40))
    assert table.outputs == [2]
    assert np.isnan(table.values[:, 0]).all()
    with pytest.raises(DataError, match="lacks the column time_s"):
        read_reference(path)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_reference_has_times_as_a_log_has(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "ft.csv"
    rows = [f"{500 * k},{k},{2 * k}" for k in range(40)]  # two a second
    path.write_text("\n".join(["t_ms,fz_n,fx_n", *rows]).replace(",", separator))
    table = read_reference(path)
    assert table.time_s.tolist() == [k / 2 for k in range(40)]
    assert table.outputs == [0, 2]
    assert table.values[3, [0, 2]].tolist() == [6.0, 3.0]


def test_columns_of_a_reference_that_are_not_used_are_named(tmp_path: Path) -> None:
    header, *rows = GOOD.splitlines()
    names = [header, "mx_nm", "Fx_n"]
    (tmp_path / "ft.csv").write_text("\n".join([",".join(names), *(f"{row},0,0" for row in rows)]))
    np.savez(tmp_path / "log.npz", time_s=np.arange(400) / 100, volts=np.ones((400, 36)))
    said = CliRunner().invoke(
        cli,
        ["calibrate", f"{tmp_path}/log.npz", "--reference", f"{tmp_path}/ft.csv", "-o", f"{tmp_path}/a.toml"],
    )
    assert f"{tmp_path}/ft.csv: columns not used: 'mx_nm', 'Fx_n'; known are fx_n, fy_n, fz_n" in said.stderr


def test_a_log_of_another_array_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", time_s=np.arange(50) / 100, volts=np.zeros((50, 5)))
    with pytest.raises(DataError, match="5 channels"):
        read_log(tmp_path / "log.npz")
    with pytest.raises(DataError, match="unknown kind of file"):
        read_log(tmp_path / "log.xlsx")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["-o", "nominal.toml"], "have a meaning"),
        (["-o", "a" * 80 + ".toml"], "at most 64 letters"),
        (["-o", "b.toml", "--plot", "p.xyz"], "name a .png"),
        (["-o", "b.toml", "--plot", "missing/p.png"], "folder that exists"),
    ],
)
def test_options_are_checked_before_the_fit(options: list[str], says: str, tmp_path: Path) -> None:
    files = [tmp_path / "log.npz", tmp_path / "ft.csv"]
    for file in files:
        file.touch()
    said = CliRunner().invoke(cli, ["calibrate", str(files[0]), "--reference", str(files[1]), *options])
    assert isinstance(said.exception, ConfigError)
    assert says in str(said.exception)


def test_an_unknown_shipped_calibration_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="shipped: wang2019-3x3"):
        load_calibration("nosuch")


def test_a_table_without_times_is_calibrated_by_its_rate_and_clock(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, 60.0, 0.05)
    force_n = np.maximum(8.0 * np.sin(time_s), 0.0)
    readings = force_n[:, np.newaxis] * rng.normal(30, 10, 15) + rng.standard_normal((len(time_s), 15))
    names = ",".join(f"c{k}" for k in range(15))
    np.savetxt(tmp_path / "log.csv", readings, delimiter=",", header=names, comments="")
    reference = np.column_stack([time_s, force_n])
    np.savetxt(tmp_path / "ft.csv", reference, delimiter=",", header="time_s,fz_n", comments="")
    command = ["calibrate", str(tmp_path / "log.csv"), "--reference", str(tmp_path / "ft.csv")]
    command += ["-o", str(tmp_path / "mine.toml"), "--array", "magnetometers-5", "--columns", "c*"]
    said = CliRunner().invoke(cli, command)
    assert isinstance(said.exception, DataError)
    assert "--rate" in str(said.exception)
    command += ["--rate", "20", "--same-clock", "--plot", str(tmp_path / "mine.png")]
    said = CliRunner().invoke(cli, command, catch_exceptions=False)
    assert (tmp_path / "mine.png").exists()  # of the only axis that is known
    numbers = json.loads(said.stdout)
    assert (numbers["late_s"], numbers["late_sd_s"]) == (0.0, 0.0)
    assert numbers["rms"]["fz_n"] < 0.1
    assert "clock of the reference: +0.000 s and" in said.stderr
