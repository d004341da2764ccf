"""Logs of others: rows that repeat a scan, and no size that a file claims."""

import json
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from bombs import npz_that_claims
from numpy.typing import NDArray
from pyarrow import parquet

from tactiled.archive.detect import analyse
from tactiled.array import FloatArray, load_array
from tactiled.errors import DataError
from tactiled.log_summary import LogTally
from tactiled.offline import Choices, detect_file
from tactiled.recording import csv_table, spacing, table_times
from tactiled.recording.spacing import rows_of_a_reading, scans_among, to_blocks
from tactiled.recording.table_times import TableOptions
from tactiled.recording.whole import read_table
from tactiled.samples.block import Gap, ScanBlock


def write(path: Path, time_s: FloatArray, volts: FloatArray) -> Path:
    """Write a table in the format that the name says."""
    names = ["time_s", *[f"c{k}" for k in range(volts.shape[1])]]
    if path.suffix == ".npz":
        np.savez_compressed(path, time_s=time_s, volts=volts)
    else:
        lines = (",".join(map(repr, row)) for row in np.column_stack([time_s, volts]).tolist())
        path.write_text("\n".join([",".join(names), *lines]))
    return path


def pressed(n: int) -> tuple[FloatArray, FloatArray]:
    """Return a log of the published array that is pressed and sheared again and again, with missing scans."""
    rng = np.random.default_rng(5)
    time_s = np.delete(np.arange(n + 3) * 0.01, [n // 3, n // 3 + 1, n // 2])
    phase = (time_s % 8.0) / 8.0
    load = np.clip(np.minimum(phase, 1 - phase) * 8, 0, 1)
    shear = np.clip(phase * 3 - 1, 0, 1) * load
    side = np.tile([0.3, 0.0, -0.3, 0.0], 9)
    volts = 1.0 + 0.3 * load[:, None] + shear[:, None] * side + rng.normal(0, 0.002, (n, 36))
    return time_s, volts


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_all_formats_give_the_same_rows(kind: str, tmp_path: Path) -> None:
    time_s, volts = pressed(300)
    volts[7] = np.nan
    volts[9, 3] = np.inf
    got_s, got = read_table(write(tmp_path / f"log.{kind}", time_s, volts))
    assert np.array_equal(got_s, np.delete(time_s, 7))
    assert np.array_equal(got, np.delete(np.where(np.isfinite(volts), volts, np.nan), 7, 0), equal_nan=True)


def polled(seed: int, n: int, *, resting: slice) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Rows of a host that polls a sensor of 10 Hz every 23 to 27 ms, and those that show a scan first."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.023, 0.027, n))
    scan = (time_s / 0.1).astype(np.int64)
    values = rng.integers(0, 4000, (scan[-1] + 1, 3)).astype(np.float64)
    values[resting] = values[resting.start]
    return time_s, values[scan], np.flatnonzero(np.diff(scan, prepend=-1))


@pytest.mark.parametrize("seed", range(5))
def test_rows_that_repeat_a_slow_sensor_are_no_scans(seed: int) -> None:
    time_s, volts, first_rows = polled(seed, 1000, resting=slice(0, 0))
    blocks = to_blocks(time_s, volts, None, np.isfinite(volts))
    assert [type(block) for block in blocks] == [ScanBlock]
    assert isinstance(blocks[0], ScanBlock)
    assert np.array_equal(blocks[0].time_s, time_s[first_rows])
    assert blocks[0].rate_hz == pytest.approx(10.0, rel=0.05)
    for rate_hz in (40.0, 10.0):  # of the rows, of the scans
        said = to_blocks(time_s, volts, rate_hz, np.isfinite(volts))[0]
        assert isinstance(said, ScanBlock)
        assert said.rate_hz == 10.0


@pytest.mark.parametrize("missing", [0.02, 0.2])
def test_missing_readings_are_no_new_ones(missing: float) -> None:
    time_s, volts, first_rows = polled(9, 1000, resting=slice(0, 0))
    volts = np.hstack([volts, volts + 1.0])  # so that a scan shows by one channel or another
    volts[np.random.default_rng(10).random(volts.shape) < missing] = np.nan
    (block,) = to_blocks(time_s, volts, None, np.isfinite(volts))
    assert isinstance(block, ScanBlock)
    assert len(block) == pytest.approx(len(first_rows), abs=5)


def test_a_slow_sensor_that_rests_goes_on_scanning() -> None:
    time_s, volts, first_rows = polled(7, 2000, resting=slice(100, 300))
    blocks = to_blocks(time_s, volts, None, np.isfinite(volts))
    assert not any(isinstance(block, Gap) for block in blocks)
    assert sum(len(block) for block in blocks if isinstance(block, ScanBlock)) == pytest.approx(
        len(first_rows), abs=10
    )


@pytest.mark.parametrize("step", [1, 5, 50])
@pytest.mark.parametrize("shape", ["swing", "ramps", "creep"])
def test_coarse_readings_without_noise_are_scans(step: int, shape: str) -> None:
    time_s = np.arange(6000) / 100
    smooth = {
        "swing": 500 * np.sin(0.5 * time_s),
        "ramps": 100 * np.abs((time_s % 20) - 10),
        "creep": 300 * np.log1p(time_s),
    }[shape]
    volts = step * np.rint(smooth / step)[:, np.newaxis]
    assert rows_of_a_reading(volts) == 1


def test_coarse_readings_that_repeat_by_chance_are_scans() -> None:
    rng = np.random.default_rng(8)
    press = np.clip(np.arange(3000) - 1000, 0, 60) // 3
    volts = np.rint(press + 0.2 * rng.normal(size=3000))[:, np.newaxis]
    assert rows_of_a_reading(volts) == 1
    (block,) = to_blocks(np.arange(3000) / 100, volts, None, np.isfinite(volts))
    assert isinstance(block, ScanBlock)
    assert len(block) == 3000


def test_a_log_that_is_read_as_a_whole_is_held_once(tmp_path: Path, memory: Callable[[], int]) -> None:
    path = tmp_path / "log.npz"
    np.savez_compressed(path, time_s=np.arange(40_000) / 100, volts=np.arange(40_000 * 32.0).reshape(-1, 32))
    tracemalloc.reset_peak()
    _, volts = read_table(path)
    assert memory() < 1.5 * volts.nbytes


def test_the_summary_of_a_long_log_keeps_an_even_part_of_its_scans(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactiled.log_summary._MOST_VALUES", 36 * 100)
    tally = LogTally(load_array("wang2019-3x3"), "log")
    time_s = np.arange(1700, dtype=np.float64) / 100
    for start in range(0, 1700, 43):
        tally.add_scans(time_s[start : start + 43], np.ones((len(time_s[start : start + 43]), 36)))
    assert (tally.n_scans, tally.first_s, tally.last_s) == (1700, 0.0, time_s[-1])
    assert 50 <= len(tally.time_s) <= 100
    assert np.array_equal(tally.time_s, time_s[:: round(tally.time_s[1] / 0.01)])
    assert tally.spacing_s == pytest.approx(0.01)


@pytest.mark.parametrize("shape", [(12_850_000, 36), (2, 10**9), (10**12, 36), (5, 36, 10**8)])
def test_an_array_that_claims_more_than_the_limit_is_not_read(
    tmp_path: Path, shape: tuple[int, ...], memory: Callable[[], int]
) -> None:
    path = npz_that_claims(tmp_path / "bomb.npz", shape, 4 << 20)
    with pytest.raises(DataError, match=r"has more than 1\.5 GB of readings; split it"):
        detect_file(path)
    assert memory() < 10_000_000


@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_header_of_an_array_that_claims_gigabytes_is_not_read(
    tmp_path: Path, version: int, memory: Callable[[], int]
) -> None:
    path = tmp_path / "head.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("time_s", "volts"):
            with archive.open(f"{name}.npy", "w") as stream:
                n_bytes = 60_000 if version == 1 else 16 << 20
                length = n_bytes.to_bytes(2 if version == 1 else 4, "little")
                stream.write(b"\x93NUMPY" + bytes([version, 0]) + length)
                for _ in range(n_bytes // 1000):
                    stream.write(b" " * 1000)
    with pytest.raises(DataError, match="must be arrays of numbers"):
        detect_file(path)
    assert memory() < 10_000_000


@pytest.mark.parametrize(
    ("n", "words"), [(100_000, "ends before the shape"), (100, "more bytes than the shape")]
)
def test_an_array_with_less_or_more_than_it_claims_is_refused(tmp_path: Path, n: int, words: str) -> None:
    path = npz_that_claims(tmp_path / "other.npz", (n, 36), 1 << 20)
    with pytest.raises(DataError, match=rf"other\.npz: cannot be read as npz: .*{words}"):
        read_table(path)


def test_the_limit_counts_an_array_of_bytes_as_the_numbers_that_it_becomes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez(tmp_path / "a.npz", volts=np.zeros((1000, 36), np.uint8))
    monkeypatch.setattr(table_times, "MOST_BYTES", 100_000)
    with pytest.raises(DataError, match=r"has more than 0\.0001 GB of readings"):
        read_table(tmp_path / "a.npz", TableOptions(rate_hz=100.0))


def test_rows_without_a_channel_are_refused(tmp_path: Path) -> None:
    """Any number of them costs no byte."""
    path = npz_that_claims(tmp_path / "rows.npz", (10**8, 0), 0)
    with pytest.raises(DataError, match="volts has 0 channels"):
        read_table(path, TableOptions(rate_hz=100.0))


def test_a_whole_table_is_read_up_to_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "log.csv", *pressed(300))
    monkeypatch.setattr(table_times, "MOST_BYTES", 50_000)
    with pytest.raises(DataError, match="has more than 5e-05 GB of readings"):
        read_table(path)


def test_a_line_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_table, "_MOST_LINE", 1000)
    (tmp_path / "log.csv").write_text("time_s,a\n0,1\n" + "1," * 600)
    with pytest.raises(DataError, match="a line has more than 1000 characters"):
        read_table(tmp_path / "log.csv")


def test_columns_first_is_read_too(tmp_path: Path) -> None:
    time_s, volts = pressed(50)
    np.savez(tmp_path / "log.npz", time_s=time_s, volts=np.asfortranarray(volts))
    assert np.array_equal(read_table(tmp_path / "log.npz")[1], volts)


def test_rows_of_a_table_of_events_name_the_board_and_come_in_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path / "log.npz", *pressed(1300))
    detect_file(path)
    printed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    monkeypatch.setattr("tactiled.archive.detect._GROUP_EVENTS", 3)
    found = parquet.ParquetFile(pyarrow.BufferReader(analyse(str(path), None, None, Choices())))
    assert found.num_row_groups == -(-len(printed) // 3) + 1
    rows_found = found.read().to_pylist()
    assert [row["topic"] for row in rows_found] == [*(event["topic"] for event in printed), "file"]
    assert {row["board"] for row in rows_found[:-1]} == {"log"}
    assert "scans in" in rows_found[-1]["summary"]


@pytest.mark.parametrize("piece_rows", [1, 7, 599, 600])
def test_the_size_of_pieces_changes_no_scan(piece_rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    readings = np.repeat(rng.normal(size=(200, 4)), 3, axis=0)
    readings[rng.random(readings.shape) < 0.2] = np.nan
    rows, is_scan = rows_of_a_reading(readings), scans_among(readings, 3)
    monkeypatch.setattr(spacing, "_PIECE_ROWS", piece_rows)
    assert rows_of_a_reading(readings) == rows == 3
    assert np.array_equal(scans_among(readings, 3), is_scan)


def test_blocks_of_a_log_take_less_memory_than_its_readings() -> None:
    readings = np.asarray(np.random.default_rng(3).normal(size=(40_000, 36)), dtype=np.float64)
    time_s, valid = np.linspace(0.0, 399.99, 40_000), np.ones(readings.shape, dtype=np.bool_)
    tracemalloc.start()
    try:
        to_blocks(time_s, readings, None, valid)
        _, most_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most_bytes < readings.nbytes
