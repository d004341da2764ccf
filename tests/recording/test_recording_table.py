"""Tables of others are read, or refused with the place."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.errors import DataError
from tactiled.recording.spacing import to_blocks
from tactiled.recording.table_times import TableOptions, TimeUnit
from tactiled.recording.whole import read_table, read_whole
from tactiled.samples.block import Gap, ScanBlock


@pytest.mark.parametrize("separator", [";", "\t"])
def test_tables_with_other_separators_are_read(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a,b\n0,1,2\n0.01,3,4\n".replace(",", separator))
    assert read_table(path)[1].tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("header", "row", "first_s"),
    [
        ("time_s,a,b,", "{t},{a},{b},", 0.0),  # as a loop over channels prints them
        ("time_s,a,b", "{t},{a},{b},", 0.0),
        (",time_s,a,b", "{k},{t},{a},{b}", 0.0),  # as pandas numbers rows
        ("\ntime_s,a,b", "{t},{a},{b}\n,,", 0.0),
        ("time_s,a,b,", "{t},{a},{b}", 0.0),
        ("time,a,b", "1970-01-02 01:00:{t:09.6f},{a},{b}", 90_000.0),
        ("Timestamp;a;b", "1970-01-02T01:00:{t:09.6f}+01:00;{a};{b}", 86_400.0),
    ],
)
@pytest.mark.parametrize("suffix", [".csv", ".CSV", ".tsv", ".txt"])
def test_what_other_programs_write(
    tmp_path: Path, header: str, row: str, first_s: float, suffix: str
) -> None:
    path = tmp_path / f"log{suffix}"
    rows = [row.format(k=k, t=k / 100, a=k + 1, b=k + 2) for k in range(50)]
    path.write_text("\n".join([header, *rows]))
    whole = read_whole(path, "load-cell", None, TableOptions(columns=("a",)))
    time_s, readings = read_table(path)
    assert whole is not None
    assert whole.time_s.tolist() == time_s.tolist()
    assert time_s - first_s == pytest.approx(np.arange(50) / 100, abs=1e-6)
    assert readings.tolist() == [[k + 1, k + 2] for k in range(50)]


@pytest.mark.parametrize("delimiter", [" ", ",", "  "])
@pytest.mark.parametrize("header", ["time_s{0}a{0}b", "pad 7, left\ntime_s{0}a{0}b"])
def test_tables_of_numpy_are_read(tmp_path: Path, delimiter: str, header: str) -> None:
    path = tmp_path / "t.txt"
    rows = [[0.0, 1.0, 2.0], [0.01, 3.0, np.nan], [0.02, 5.0, 6.0]]
    np.savetxt(path, rows, delimiter=delimiter, header=header.format(delimiter))
    time_s, readings = read_table(path)
    assert time_s == pytest.approx([0.0, 0.01, 0.02])
    np.testing.assert_array_equal(readings, [[1, 2], [3, np.nan], [5, 6]])


def test_a_table_of_ros_is_read(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("%time,field.data0\n1600000000000000000,1\n1600000000010000000,\n1600000000020000000,3\n")
    time_s, readings = read_table(path, TableOptions(time_unit="ns"))
    assert time_s - time_s[0] == pytest.approx([0.0, 0.02], abs=1e-6)
    assert readings.tolist() == [[1.0], [3.0]]


def test_lines_are_counted_with_the_comments(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text("# one\n# time_s a\n0 1\n0.01 x\n")
    with pytest.raises(DataError, match="line 4: 'x' is not a number"):
        read_table(path)
    path.write_text("# one\n# two\ntime_s a\n0 1\n0.01\n")
    with pytest.raises(DataError, match="line 5 has 1 cells, the header has 2"):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "columns", "readings"),
    [
        ("%time,header.frame_id,x\n0,ft_link,1\n0.01,ft_link,2\n", ("x",), [[1.0], [2.0]]),
        ("# made by X\n\ntime_s,a\n0,1\n0.01,2\n", (), [[1.0], [2.0]]),
        ("#,time_s,a,note\n1,0,5,ok\n2,0.01,6,ok\n", ("a",), [[5.0], [6.0]]),
        ('# time_s,a\n0,1\n# a "pause\n0.01,2\n% end\n', (), [[1.0], [2.0]]),
        ("time_s,a\n# s,V\n0,1\n0.01,2\n", (), [[1.0], [2.0]]),
    ],
)
def test_comments_and_text_among_the_columns(
    text: str, columns: tuple[str, ...], readings: list[list[float]], tmp_path: Path
) -> None:
    (tmp_path / "t.csv").write_text(text.replace("time,", "time_s,"))
    time_s, found = read_table(tmp_path / "t.csv", TableOptions(columns=columns))
    assert time_s == pytest.approx([0.0, 0.01])
    assert found.tolist() == readings


def test_the_name_of_a_single_column_may_have_spaces(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("Force (N)\n1\n2\n")
    assert read_table(tmp_path / "t.csv", TableOptions(rate_hz=100.0))[1].tolist() == [[1.0], [2.0]]


def test_lines_behind_comments_have_their_number(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("# one\n\ntime_s,a\n# two\n0,1\n# three\n0.01,x\n")
    with pytest.raises(DataError, match="line 7: 'x' is not a number"):
        read_table(tmp_path / "t.csv")
    (tmp_path / "t.csv").write_text("# time_s,a\n0,NA\n0.01,2\n")
    with pytest.raises(DataError, match="line 2: 'NA' is not a number"):
        read_table(tmp_path / "t.csv")


def test_a_whole_time_beside_seconds_is_no_fraction_of_them(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("sec,usec,a\n5,5000000,1\n5,5010000,2\n")
    with pytest.raises(DataError, match=r"usec should be a fraction of a second, .* say --time-unit us"):
        read_table(path)
    assert read_table(path, TableOptions(time_unit="us"))[0] == pytest.approx([5.0, 5.01])


def test_a_comment_above_dates_names_the_columns(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("# time,a\n2026-11-29 08:15:00.00,1\n2026-11-29 08:15:00.01,2\n")
    time_s, readings = read_table(path)
    assert np.diff(time_s) == pytest.approx([0.01], abs=1e-6)
    assert readings.tolist() == [[1.0], [2.0]]


def test_a_row_that_is_short_is_refused_where_lines_end_with_a_separator(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,a,b,\n0,1,2,\n0.01,3,\n0.02,5,6,\n")
    with pytest.raises(DataError, match="line 3 has 3 cells, the header has 4"):
        read_table(tmp_path / "log.csv")


@pytest.mark.parametrize("rows", ['0,"1,2\n0.01,3,4\n', '0,1,"2\n0.01,3,4"\n0.02,5,6\n'])
def test_a_quotation_mark_that_swallows_lines_is_refused(tmp_path: Path, rows: str) -> None:
    (tmp_path / "log.csv").write_text("time_s,a,b\n" + rows)
    with pytest.raises(DataError, match="line 2: a quotation mark has no other one in this line"):
        read_table(tmp_path / "log.csv", TableOptions(columns=("a",)))


def test_columns_without_a_name_are_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "log.csv").write_text("time_s,a,,b\n0,1,2,3\n0.01,4,5,6\n")
    assert read_table(tmp_path / "log.csv")[1].tolist() == [[1, 3], [4, 6]]
    assert "columns without a name are left out: [3]" in caplog.text
    (tmp_path / "log.csv").write_text(",time_s\n0,0\n1,0.01\n")
    with pytest.raises(DataError, match="the header names no channel beside time_s"):
        read_table(tmp_path / "log.csv")


def test_dates_are_the_times_where_nothing_is_better(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"2026-11-29 08:15:0{k // 20},{50 * k},{k}" for k in range(60)]  # rounded to seconds
    path.write_text("\n".join(["timestamp,t_ms,a", *rows]))
    assert read_table(path)[0].tolist() == pytest.approx([0.05 * k for k in range(60)])
    path.write_text("\n".join(["time_s,a", *(row[:20] + row.split(",")[2] for row in rows)]))
    assert read_table(path, TableOptions(rate_hz=20.0))[0][:2].tolist() == [0.0, 0.05]
    with pytest.raises(DataError, match="--time-unit ms, but the times are in time_s: which is it"):
        read_table(path, TableOptions(time_unit="ms"))
    with pytest.raises(DataError, match="time_s does not grow at row 2 "):
        read_table(path)


@pytest.mark.parametrize("missing", ["", '""'])
def test_a_row_of_empty_cells_counts_where_a_rate_spaces_the_rows(tmp_path: Path, missing: str) -> None:
    (tmp_path / "log.csv").write_text(f"a,b\n1,2\n{missing},{missing}\n3,4\n")
    assert read_table(tmp_path / "log.csv", TableOptions(rate_hz=100.0))[0].tolist() == [0.0, 0.02]
    (tmp_path / "log.csv").write_text(f'a\n1\n""\n3\n{missing}')
    assert read_table(tmp_path / "log.csv", TableOptions(rate_hz=100.0))[0].tolist() == [0.0, 0.02]


def test_dates_of_a_slow_log_are_taken_as_they_are(tmp_path: Path) -> None:
    rows = [f"2026-11-29 08:15:{k:02d},{k}" for k in range(50)]
    (tmp_path / "log.csv").write_text("\n".join(["time,a", *rows]))
    assert np.diff(read_table(tmp_path / "log.csv")[0]).tolist() == [1.0] * 49


def test_rows_without_readings_are_missing_scans(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{k / 100},{k},nan" if k % 9 else f"{k / 100},," for k in range(30)]
    path.write_text("\n".join(["time_s,a,b", *rows]))
    time_s, readings = read_table(path)
    missing = [
        item for item in to_blocks(time_s, readings, None, np.isfinite(readings)) if isinstance(item, Gap)
    ]
    assert [gap.n_missing for gap in missing] == [1, 1, 1]


def test_npz_of_others_needs_no_names_of_ours(tmp_path: Path) -> None:
    readings = np.arange(24).reshape(2, 4, 3)
    np.savez(tmp_path / "named.npz", t=[0, 10], taxels=readings)
    np.savez(tmp_path / "alone.npz", taxels=readings)
    np.savez(tmp_path / "two.npz", t=[0, 10], left=readings, right=readings)
    named_s, named = read_table(tmp_path / "named.npz", TableOptions(time_unit="ms"))
    alone_s, alone = read_table(tmp_path / "alone.npz", TableOptions(rate_hz=100.0))
    assert named_s.tolist() == alone_s.tolist() == [0, 0.01]
    assert named.tolist() == alone.tolist() == readings.reshape(2, 12).tolist()
    for name, says in (("named", "lacks the array time_s;"), ("two", "lacks the array volts;")):
        with pytest.raises(DataError, match=says):
            read_table(tmp_path / f"{name}.npz", TableOptions(time_unit=None if name == "named" else "ms"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", "lacks the column time_s"),
        ("", "lacks the column time_s"),
        ("time_s,a\n0,1\n", "at least two"),
        ("time_s,a\n0,1\n0.1\n", "line 3 has 1 cells"),
        ("time_s,a\n0,1\n0.1,x\n", "line 3: 'x' is not a number"),
        ("time_s,a\n0,1\n0.1,1_5\n", "line 3: '1_5' is not a number"),
        ("time_s;a\n0;1\n0;0,5\n", "line 3: '0,5' is not a number; write decimals with a point"),
        ("0.0,1\n0.1,2\n0.2,2\n", "the first line has numbers only; write a line of names above it"),
        ("time_s,a\n0,1\n0,2\n", "time_s does not grow at row 2"),
        ("time_s,a\n0,1\n,2\n", "not a number in row 2"),
        ("time_s,a,label\n0,1,slip\n", "'slip' is not a number; --columns chooses the channels"),
        ("time_s,a,\n0,1,2\n", "line 2: the last cell has no name in the header"),
        ("time_s/a\n0/1\n", "the first line names the columns, with commas, .* or spaces between"),
        ("time,a\n27.03.2025 14:33,1\n", "lacks the column time_s"),
    ],
)
def test_bad_tables_are_refused_with_their_place(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=says) as caught:
        read_table(path)
    assert "bad.csv" in str(caught.value)


def test_text_in_another_encoding_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,a\n0,1\n", encoding="utf-16")
    with pytest.raises(DataError, match=r"log\.csv: no text in UTF-8; save it in this encoding"):
        read_table(tmp_path / "log.csv")


def table(path: Path, spacing_s: float) -> Path:
    np.savez(path, time_s=np.arange(50) * spacing_s, volts=np.zeros((50, 2)))
    return path


@pytest.mark.parametrize(
    ("spacing_s", "says"),
    [
        (
            1e-12,
            r"1e-12 s apart by time_s, 1e\+12 Hz, and no board is faster than 20000 Hz; .* in seconds",
        ),
        (28.0, "0.0357143 Hz; times are taken in seconds: if they are in ms say --time-unit ms"),  # 35.7 Hz
        (10.0, "0.1 Hz; .* --time-unit ms"),  # 100 Hz
        (1.0, "1 Hz; .* if they count rows divide by the rate; if scans are so slow, give --rate 1"),
        (1e4, "0.0001 Hz; .* --time-unit us"),  # 100 Hz
    ],
)
def test_implausible_times_are_refused_with_a_remedy(tmp_path: Path, spacing_s: float, says: str) -> None:
    with pytest.raises(DataError, match=rf"t\.npz: rows are .*{says}"):
        read_table(table(tmp_path / "t.npz", spacing_s))


def test_a_slow_log_is_read_where_its_rate_is_stated(tmp_path: Path) -> None:
    time_s, _ = read_table(table(tmp_path / "t.npz", 0.2), TableOptions(5.0))
    assert time_s[1] == 0.2
    for spacing_s in (1e-12, 28.0):
        with pytest.raises(DataError, match="rows are"):
            read_table(table(tmp_path / "t.npz", spacing_s), TableOptions(1 / spacing_s))


def test_a_unit_that_is_given_wrongly_is_answered_by_another(tmp_path: Path) -> None:
    path = table(tmp_path / "t.npz", 1.2e4)  # 83 Hz in microseconds
    with pytest.raises(DataError, match="times are taken in ms: if they are in us say --time-unit us"):
        read_table(path, TableOptions(time_unit="ms"))


def test_a_header_that_counts_the_columns_is_one(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("0,1\n5.5,6\n7,8.5\n9,9\n")
    _, readings = read_table(tmp_path / "t.csv", TableOptions(rate_hz=100.0))
    np.testing.assert_array_equal(readings, [[5.5, 6.0], [7.0, 8.5], [9.0, 9.0]])


def test_a_rate_that_is_half_of_that_of_the_stamps_is_refused() -> None:
    time_s, volts = np.arange(50) / 100.0, np.zeros((50, 2))
    with pytest.raises(DataError, match=r"a rate of 50 Hz, but rows are 0.01 s apart"):
        to_blocks(time_s, volts, 50.0, np.isfinite(volts))


@settings(max_examples=50, deadline=None)
@given(rate_hz=st.floats(20.0, 640.0), first_s=st.floats(0.0, 1.0))
def test_stamps_in_milliseconds_tell_the_rate_and_no_missing_scans(rate_hz: float, first_s: float) -> None:
    time_s = np.round(first_s + np.arange(2000) / rate_hz, 3)
    volts = np.random.default_rng(0).normal(size=(2000, 2))
    (block,) = to_blocks(time_s, volts, None, np.isfinite(volts))
    assert isinstance(block, ScanBlock)
    assert block.rate_hz == pytest.approx(rate_hz, rel=0.01)


def test_an_npz_of_other_arrays_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", t=np.zeros(3))
    with pytest.raises(DataError, match=r"lacks the array time_s and volts; it has \['t'\]"):
        read_table(tmp_path / "x.npz")
    (tmp_path / "y.npz").write_bytes(b"PK nonsense")
    with pytest.raises(DataError, match="not a complete npz file"):
        read_table(tmp_path / "y.npz")


def test_readings_marked_invalid_become_nan(tmp_path: Path) -> None:
    volts = np.ones((3, 2))
    valid = np.array([[True, False], [True, True], [False, True]])
    np.savez(tmp_path / "v.npz", time_s=np.arange(3) / 100, volts=volts, valid=valid)
    _, got = read_table(tmp_path / "v.npz")
    assert np.isnan(got).tolist() == (~valid).tolist()
    np.savez(tmp_path / "w.npz", time_s=np.arange(3) / 100, volts=volts, valid=valid[:, :1].repeat(5, axis=1))
    with pytest.raises(DataError, match=r"w\.npz: valid \(3, 5\) should have the shape of volts \(3, 2\)"):
        read_table(tmp_path / "w.npz")


@pytest.mark.parametrize("name", ["stamp_ms", "t_ms", "timestamp_ms", "time_ms"])
def test_a_name_may_say_the_unit_of_the_times(name: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"{name},a,b\n1000,1,2\n1010,4,5\n")
    time_s, readings = read_table(path)
    assert time_s == pytest.approx([1.0, 1.01])
    assert readings.tolist() == [[1.0, 2.0], [4.0, 5.0]]
    with pytest.raises(DataError, match=f"--time-unit s, but the times are in {name}: which is it?"):
        read_table(path, TableOptions(time_unit="s"))
    assert read_table(path, TableOptions(rate_hz=50.0))[0] == pytest.approx([1.0, 1.01])
    arrays: dict[str, Any] = {name: [1000, 1010], "pad": np.ones((2, 4))}
    np.savez(tmp_path / "t.npz", **arrays)
    assert read_table(tmp_path / "t.npz")[0] == pytest.approx([1.0, 1.01])


@pytest.mark.parametrize(
    ("header", "used", "unused"),
    [
        ("time,stamp_ms,a", "stamp_ms", "time"),
        ("Time [ms],field.header.stamp,a", "Time [ms]", "field.header.stamp"),
        ("time_\u00b5s,millis,a", "time_\u00b5s", "millis"),
        ("wall.timestamp,time_s,a", "time_s", "wall.timestamp"),
    ],
)
def test_a_second_column_of_times_is_no_channel(
    header: str, used: str, unused: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "t.csv"
    at = header.split(",").index(used)
    rows = [[900.0 + 7 * k, 900.0 + 7 * k, 5.0 + k] for k in range(3)]
    for k, row in enumerate(rows):
        row[at] = {"time_s": 0.01, "time_\u00b5s": 10_000.0}.get(used, 10.0) * k
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]), encoding="utf-8")
    time_s, readings = read_table(path)
    assert time_s == pytest.approx([0.0, 0.01, 0.02])
    assert readings.tolist() == [[5.0], [6.0], [7.0]]
    assert f"times are those of {used}; left out: {unused} (" in caplog.text
    caplog.clear()
    assert read_table(path, TableOptions(columns=[unused, "a"]))[1].shape == (3, 2)
    assert not caplog.text


def test_two_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("time_s,a,b,a\n0,1,2,3\n0.01,1,2,3\n")
    with pytest.raises(DataError, match="two columns have the same name: a; rename one"):
        read_table(path)
    assert read_table(path, TableOptions(columns=["b"]))[1].tolist() == [[2.0], [2.0]]


@pytest.mark.parametrize(
    ("names", "per_s"),
    [
        ("sec,nsec", 10**9),
        ("sec,nanosec", 10**9),
        ("header.stamp.secs,header.stamp.nsecs", 10**9),
        ("sec,usec", 10**6),
    ],
)
def test_seconds_and_their_fraction_are_one_time(names: str, per_s: int, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    late, early = per_s * 99 // 100, per_s // 100
    path.write_text(f"{names},a\n1700000000,{late},1\n1700000001,0,2\n1700000001,{early},3\n")
    time_s, readings = read_table(path)
    assert np.diff(time_s) == pytest.approx([0.01, 0.01], abs=1e-6)
    assert readings.tolist() == [[1.0], [2.0], [3.0]]
    np.savez(tmp_path / "t.npz", sec=[1, 2, 2], nanosec=[99e7, 0, 1e7], pad=np.ones((3, 2)))
    assert read_table(tmp_path / "t.npz")[0] == pytest.approx([1.99, 2.0, 2.01])


def test_channels_that_are_named_like_times_stay(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "t.csv"
    path.write_text("time_s,T,s,ms,left.t,f_s\n0,1,2,3,4,5\n0.01,1,2,3,4,5\n")
    assert read_table(path)[1].shape == (2, 5)
    assert not caplog.text


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        ((0, 0), "stamp_ms does not grow at row 2 .*delete the times and give --rate"),
        ((0, ""), "stamp_ms is not a number in row 2"),
        ((0, 1e6), "1000 s apart by stamp_ms, 0.001 Hz; times are taken in ms"),
    ],
)
def test_errors_name_the_times_of_the_file(tmp_path: Path, stamps: tuple[object, object], says: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"stamp_ms,a\n{stamps[0]},1\n{stamps[1]},2\n")
    with pytest.raises(DataError, match=says) as caught:
        read_table(path)
    assert "time_s" not in str(caught.value)


def test_a_name_without_a_unit_comes_before_one_with_another(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("time_us,t,a\n5,0,1\n6,10,4\n")
    time_s, readings = read_table(path, TableOptions(time_unit="ms"))
    assert time_s == pytest.approx([0.0, 0.01])
    assert readings.tolist() == [[1.0], [4.0]]


def test_columns_are_chosen_by_name_and_times_have_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("note,t,b2,b1,a\nx,0,1,2,3\ny,10,4,5,6\nz,20,7,8,9\n")
    time_s, volts = read_table(path, TableOptions(columns=("a", "b*"), time_unit="ms"))
    assert time_s == pytest.approx([0.0, 0.01, 0.02])
    assert volts.tolist() == [[3.0, 1.0, 2.0], [6.0, 4.0, 5.0], [9.0, 7.0, 8.0]]
    _, volts = read_table(path, TableOptions(columns=("a", "[ab]*"), time_unit="ms"))
    assert volts[0].tolist() == [3.0, 1.0, 2.0]  # each once
    with pytest.raises(DataError, match=r"no column 'c' of --columns; the header has note, t, b2, b1, a"):
        read_table(path, TableOptions(columns=("c",), time_unit="ms"))
    with pytest.raises(DataError, match=r"times named time, t, timestamp or stamp need a unit"):
        read_table(path, TableOptions(columns=("a",)))


@pytest.mark.parametrize(("unit", "of_unit_s"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_times_have_the_unit_that_is_stated(tmp_path: Path, unit: TimeUnit, of_unit_s: float) -> None:
    path = tmp_path / "t.csv"
    path.write_text("t,a\n" + "".join(f"{k / 100 / of_unit_s:.0f},{k}\n" for k in range(0, 400, 100)))
    time_s, _ = read_table(path, TableOptions(columns=("a",), time_unit=unit))
    assert time_s == pytest.approx([0.0, 1.0, 2.0, 3.0])


def test_a_log_with_times_keeps_them_though_a_rate_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("time_s,a\n0.00,1\n0.02,3\n0.05,5\n")
    time_s, _ = read_table(path, TableOptions(rate_hz=50.0))
    assert time_s == pytest.approx([0.0, 0.02, 0.05])


def test_a_log_without_times_has_those_of_its_rate(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("a,b\n1,2\n3,4\n5,6\n")
    time_s, volts = read_table(path, TableOptions(rate_hz=50.0))
    assert time_s == pytest.approx([0.0, 0.02, 0.04])
    assert volts.shape == (3, 2)


@pytest.mark.parametrize("seed", range(5))
def test_stamps_that_jitter_are_no_missing_scans(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s = 5.0 + (np.arange(2000) + 0.1 * rng.standard_normal(2000).clip(-3, 3)) / 35.6
    kept = np.delete(np.arange(2000), [700, 701, 1500])
    valid = np.ones((2000, 1), dtype=np.bool_)
    assert len(to_blocks(time_s, np.zeros((2000, 1)), 36.0, valid)) == 1  # a rate that is wrong by 1 %
    items = to_blocks(time_s[kept], np.zeros((len(kept), 1)), None, valid[kept])
    gaps = [(item.n_missing, item.index) for item in items if isinstance(item, Gap)]
    assert gaps == [(2, 702), (1, 1501)]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_steps_of_two_lengths_are_no_gaps_and_a_pause_is_one(seed: int) -> None:
    """A host that polls: steps of 73 and 136 ms in any order, and a pause of two seconds."""
    rng = np.random.default_rng(seed)
    steps_s = np.where(rng.random(400) < 0.4, 0.136, 0.073) + rng.uniform(-0.002, 0.002, 400)
    steps_s[200] = 2.0
    time_s = 5.0 + np.cumsum(steps_s)
    items = to_blocks(time_s, np.zeros((400, 3)), None, np.ones((400, 3), dtype=np.bool_))
    gaps = [item for item in items if isinstance(item, Gap)]
    assert len(gaps) == 1
    blocks = [item for item in items if isinstance(item, ScanBlock)]
    np.testing.assert_array_equal(np.concatenate([block.time_s for block in blocks]), time_s)
    assert abs(blocks[0].rate_hz * float(np.delete(steps_s, 200).mean()) - 1) < 0.01


@pytest.mark.parametrize("catch_up_s", [2.5e-4, 4e-3])
def test_rows_that_wait_in_the_host_are_not_missing_but_those_lost_behind_them_are(catch_up_s: float) -> None:
    """The host reads nothing for 0.2 s, then all rows that wait, then 10 rows are lost."""
    rng = np.random.default_rng(0)
    instants_s = np.arange(500) / 100
    free_s = instants_s[220] + np.arange(60) * catch_up_s
    stamps_s = instants_s + rng.normal(0, 2e-4, 500)
    stamps_s[200:260] = np.maximum(free_s, instants_s[200:260] + 1e-3)
    lost = np.delete(np.arange(500), slice(300, 310))
    volts = rng.normal(0, 1, (500, 4))
    valid = np.ones_like(volts, dtype=np.bool_)
    (block,) = to_blocks(stamps_s, volts, None, valid)
    assert isinstance(block, ScanBlock)
    assert block.index[-1] == 499
    items = to_blocks(stamps_s[lost], volts[lost], None, valid[lost])
    assert [item.n_missing for item in items if isinstance(item, Gap)] == [10]
    last = items[-1]
    assert isinstance(last, ScanBlock)
    assert last.index[-1] == 499
