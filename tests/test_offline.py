"""`tactiled detect FILE` as its users run it: their own array, their own log."""

import csv
import itertools
import json
import re
import tomllib
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tactiled import log_summary
from tactiled.array import Array, ArrayFile, FloatArray, build, load_array
from tactiled.detect.signal.slip_gate import KnownSliding
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.simulate import Simulation
from tactiled.errors import ConfigError, DataError
from tactiled.events.types import Event, SlipEvent
from tactiled.force.calibration import load_calibration
from tactiled.offline import Choices, array_of_config, detect_file
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.export import export_csv
from tactiled.recording.replay import replay
from tactiled.recording.writer import RecordingWriter
from tactiled.tomlfile import parse
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Scan
from tactiled.wire.layout import load_layout

Floats = NDArray[np.float64]
ONSET_S = 6.0


def press_and_slide(
    array: Array, rate_hz: float, direction_deg: float, scale: float = 1.0
) -> tuple[Floats, Floats]:
    """A log with known truth, made here: pressure up to 1.5 s, slide from `ONSET_S` on."""
    rng = np.random.default_rng(5)
    time_s = 100.0 + np.arange(int(8 * rate_hz)) / rate_hz
    t = time_s - 100.0
    load = np.clip((t - 0.5) / 1.0, 0, 1)
    slide = np.where(t > ONSET_S, 1 - np.exp(-(t - ONSET_S) / 0.15), 0.0)
    theta = np.radians(direction_deg)
    shear = array.shear_weights()
    pattern_x, pattern_y = np.sign(shear).sum(axis=1)
    normal = (array.normal_weights() != 0).any(axis=0).astype(float)
    volts = np.outer(load * 1.2, normal)
    volts += 0.4 * np.outer(slide, np.cos(theta) * pattern_x + np.sin(theta) * pattern_y)
    if not array.has_shear:  # friction tilts the pad: pressure moves to the trailing taxels
        along = np.cos(theta) * array.x_mm + np.sin(theta) * array.y_mm
        volts -= 0.3 * np.outer(slide, (along - along.mean())[array.channel_taxel] / np.ptp(along))
    volts += rng.normal(0, 3e-4, volts.shape)
    return time_s, np.asarray(scale * volts, dtype=np.float64)


def write_csv(path: Path, time_s: Floats, volts: Floats) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_s", *[f"c{k}" for k in range(volts.shape[1])]])
        writer.writerows([t, *row] for t, row in zip(time_s.tolist(), volts.tolist(), strict=True))


@pytest.mark.parametrize(
    ("name", "rate_hz", "setting"),
    [
        ("wang2019-3x3", 100.0, "balanced"),
        ("xyz-two-pads-4x4", 60.0, "balanced"),
        ("wang2019-3x3", 100.0, "wang2019"),
    ],
)
def test_a_log_of_any_array_gives_its_slip(
    name: str,
    rate_hz: float,
    setting: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    time_s, volts = press_and_slide(load_array(name), rate_hz, direction_deg=130.0)
    write_csv(tmp_path / "log.csv", time_s, volts)
    picture = tmp_path / "log.png"
    found = detect_file(tmp_path / "log.csv", array=name, choices=Choices(setting=setting), plot=picture)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(events) == found.n_printed
    onsets = [e for e in events if e["topic"] == "slip" and e["state"] == "onset"]
    assert len(onsets) == len({e["kind"] for e in onsets})  # incipient, and gross once it is
    assert onsets[0]["onset"] == pytest.approx(100.0 + ONSET_S, abs=max(3 * onsets[0]["onset_sd_s"], 0.05))
    assert onsets[0]["direction_deg"] == pytest.approx(130.0, abs=3.0)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_load_that_moves_over_an_array_without_shear_is_an_incipient_slip_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Such arrays tell sliding by what passes under the skin; load that moves may be that of a tug."""
    time_s, volts = press_and_slide(load_array("normal-4x4"), 35.7, direction_deg=130.0)
    write_csv(tmp_path / "log.csv", time_s, volts)
    detect_file(tmp_path / "log.csv", array="normal-4x4", choices=Choices(setting="fast"))
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert "contact" in {event["topic"] for event in events}
    slips = [event for event in events if event["topic"] == "slip"]
    assert {event["kind"] for event in slips} == {"incipient"}
    assert slips[0]["onset"] == pytest.approx(100.0 + ONSET_S, abs=1.0)


def test_a_user_array_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two taxels listed one by one, z before x, x turned round: geometry is data."""
    file = tmp_path / "mine.toml"
    file.write_text(
        """
name = "mine"
[[taxels]]
x_mm = 0.0
y_mm = 0.0
[[taxels]]
x_mm = 4.0
y_mm = 1.0
"""
        + "".join(
            f'[[channels]]\nname = "{kind}"\nkind = "{kind}"\ntaxel = {taxel}\nsign = {sign}\n'
            for taxel in (0, 1)
            for kind, sign in (("normal", 1), ("shear_x", -1), ("shear_y", 1))
        )
    )
    time_s, volts = press_and_slide(load_array(str(file)), 100.0, direction_deg=-45.0)
    np.savez(tmp_path / "log.npz", time_s=time_s, volts=volts)
    detect_file(tmp_path / "log.npz", array=str(file))
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    onset = next(e for e in events if e["topic"] == "slip" and e["state"] == "onset")
    assert onset["direction_deg"] == pytest.approx(-45.0, abs=3.0)


def test_a_recording_gives_the_events_that_were_live(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = load_board("board-v1", "wang2019-3x3")
    live = Pipeline(load_layout("board-v1"), load_array("wang2019-3x3"))
    slips: list[float] = []
    with RecordingWriter(tmp_path / "demo.mcap", Header(source)) as writer:
        for now_s, data in Simulation(load_scene("demo"), live.layout, duration_s=9.0):
            writer.read(Read(now_s, 1.7e9, data))
            for out in live.receive_data(data, now_s):
                if isinstance(out, Event) and isinstance(out, SlipEvent):
                    slips.append(out.onset_s)
    detect_file(tmp_path / "demo.mcap")
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [e["onset"] for e in events if e["topic"] == "slip"] == slips
    assert slips


def slide_over_grooves_handed_over_late(path: Path) -> None:
    """A recording; from 3 s on the host sleeps for 0.45 s of each half second, then reads all that waits."""
    phases = [
        {"kind": "rest", "duration_s": 0.3},
        {"kind": "press", "duration_s": 1.0, "force_n": 20.0},
        {"kind": "hold", "duration_s": 1.2},
        {"kind": "slide", "duration_s": 4.0, "speed_mm_s": 4.0},
        {"kind": "lift", "duration_s": 0.5},
    ]
    surface = {"kind": "grooves", "period_mm": 1.2, "angle_deg": 20.0}
    scene = parse({"name": "short", "surface": surface, "phases": phases}, Scene, "test")
    source = load_board("board-v1", "wang2019-3x3")
    with RecordingWriter(path, Header(source)) as writer:
        start_s = 0.0
        for arrival_s, data in Simulation(scene, source.layout, seed=3):
            start_s = start_s or arrival_s
            slept_s, rest_s = divmod(arrival_s - start_s, 0.5)
            if arrival_s - start_s > 3.0 and rest_s < 0.45:
                arrival_s = start_s + 0.5 * slept_s + 0.45
            writer.read(Read(arrival_s, 0.0, data))


def test_lateness_of_a_recording_is_no_reason_to_refuse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Who acted live had to know of it; `replay` says so again, and `detect` answers as on the CSV of it."""
    recording, table = tmp_path / "late.mcap", tmp_path / "late.csv"
    slide_over_grooves_handed_over_late(recording)
    lines: list[str] = []
    replay([recording], lines.append, topics=("texture", "slip", "scan"))
    live = [json.loads(line) for line in lines]
    assert sum(e["late"] for e in live if e["topic"] == "scan") > 100
    assert "stale" in [e["status"] for e in live if e["topic"] == "texture"]
    export_csv([recording], table)
    found = []
    for path in (recording, table):
        detect_file(path)
        found.append([json.loads(line) for line in capsys.readouterr().out.splitlines()])
    for events in found:
        assert all(e["valid"] for e in events if e["topic"] in ("slip", "contact"))
    ours, theirs = ([e for e in events if e["topic"] == "texture"] for events in found)
    # The table has no times of channels: slips, and with them windows, may begin and end at other hops.
    assert {e["status"] for e in ours} == {e["status"] for e in theirs} == {"ok"}
    answered = [e for e in ours if e["status"] == "ok"]
    assert len(answered) > 5
    assert [e["period_mm"] for e in answered] == pytest.approx([1.2] * len(answered), abs=0.05)


def test_a_recording_continues_after_a_wrong_board(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    source = load_board("board-v1", "wang2019-3x3")
    right = Simulation(load_scene("prescribed"), source.layout, duration_s=7.5)
    wrong = Simulation(
        load_scene("prescribed"),
        source.layout,
        board=EmulatedBoardParams(array_id="normal-3x3"),
        duration_s=1.0,
    )
    read = [Read(arrival_s, 0.0, data) for arrival_s, data in wrong]
    moved_s = read[-1].arrival_s + 1.0
    with RecordingWriter(tmp_path / "wrong.mcap", Header(source)) as writer:
        for one in read:
            writer.read(one)
    with pytest.raises(DataError, match="normal-3x3"):
        detect_file(tmp_path / "wrong.mcap")
    with RecordingWriter(tmp_path / "both.mcap", Header(source)) as writer:
        for one in read:
            writer.read(one)
        for arrival_s, data in right:
            writer.read(Read(arrival_s + moved_s, 0.0, data))
    capsys.readouterr()
    assert detect_file(tmp_path / "both.mcap").n_printed > 0
    assert '"topic": "slip"' in capsys.readouterr().out
    assert "normal-3x3" in caplog.text
    assert "its scans are left out" in caplog.text


def test_events_contain_no_nan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time_s, volts = press_and_slide(load_array("wang2019-3x3"), 100.0, 0.0)
    volts[::3, 5] = np.nan
    volts[:, 8] = np.nan
    write_csv(tmp_path / "holes.csv", time_s, volts)
    detect_file(tmp_path / "holes.csv", plot=tmp_path / "holes.png")
    text = capsys.readouterr().out
    assert "NaN" not in text
    assert '"onset"' in text


PAD = """
name = "pad"
unit = "count"
range = [0, 4095]
zero = "first 0.3 s"
taxel_count = 16
[[taxel_channels]]
name = "N"
kind = "normal"
"""


def ridges_under_a_pad(path: Path, ripple: float = 0.05) -> None:
    """A log of counts with times in ms, which jitter: pressed at 0.5 s, then 2.5 mm ridges at 10 mm/s."""
    rng = np.random.default_rng(1)
    rows = 300
    t = np.arange(rows) / 35.6
    load = np.clip((t - 0.5) / 0.5, 0, 1)[:, np.newaxis]
    wave = np.cos(2 * np.pi * 4.0 * t[:, np.newaxis] + rng.uniform(0, 6, 16))
    counts = 2000 + 400 * load * (1 + ripple * wave) + rng.normal(0, 8, (rows, 16))
    stamps_ms = 1000 * (t + rng.normal(0, 0.002, rows))
    header = ["timestamp", *[f"tax{k}" for k in range(16)], "note"]
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        for stamp, row in zip(stamps_ms, np.rint(counts).astype(int).tolist(), strict=True):
            writer.writerow([f"{stamp:.2f}", *row, "x"])


def test_a_log_in_counts_and_milliseconds_gives_its_period(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ridges_under_a_pad(tmp_path / "log.csv")
    (tmp_path / "pad.toml").write_text(PAD)
    choices = Choices(
        speed_mm_s=10.0, max_tilt_deg=30.0, sliding=KnownSliding(1.2), columns=("tax*",), time_unit="ms"
    )
    log = detect_file(tmp_path / "log.csv", str(tmp_path / "pad.toml"), choices=choices)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    answers = [e for e in events if e["topic"] == "texture"]
    assert {e["status"] for e in answers} == {"period-only"}
    assert answers[-1]["period_mm"] == pytest.approx(2.5, rel=0.005)
    assert answers[-1]["timestamp"] == pytest.approx(8.3, abs=0.2)
    contact = [e for e in events if e["topic"] == "contact"]
    assert (contact[0]["state"], contact[0]["timestamp"]) == ("loading", pytest.approx(0.55, abs=0.1))
    lines = list(choices.summary(log))
    assert lines[0].startswith("300 scans in 8.397 s: 35.61 Hz, spacing varies by 8.1 %")
    assert lines[1].endswith("% of the range")
    assert lines[2].startswith("in contact 7.8 s")
    assert lines[-1] == f"texture: period-only {len(answers)}"


def test_what_is_not_asked_for_is_neither_computed_nor_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ridges_under_a_pad(tmp_path / "log.csv")
    (tmp_path / "pad.toml").write_text(PAD.replace("zero =", "# zero ="))
    choices = Choices(time_unit="ms", columns=("tax*",), tare_s=0.3, topics=("contact",))
    log = detect_file(tmp_path / "log.csv", str(tmp_path / "pad.toml"), choices=choices)
    assert {json.loads(line)["topic"] for line in capsys.readouterr().out.splitlines()} == {"contact"}
    assert not log.textures


def test_parameters_come_from_the_file_and_options_replace_them(tmp_path: Path) -> None:
    config = tmp_path / "hand.toml"
    config.write_text(
        '[detect]\nsetting = "quiet"\n[detect.grip]\nfriction = 0.2\n[detect.texture]\nspeed_mm_s = 3.0\n'
    )
    params = Choices(config=config, period_mm=(0.5, 3.0)).params()
    assert (params.setting, params.grip.friction) == ("quiet", 0.2)
    assert (params.texture.speed_mm_s, params.texture.max_period_mm) == (3.0, 3.0)
    assert Choices(config=config, speed_mm_s=4.0, setting="fast").params().texture.speed_mm_s == 4.0
    (tmp_path / "pad.toml").write_text(PAD)
    with pytest.raises(ConfigError, match=r"pad\.toml:.*no table \[detect\]"):
        Choices(config=tmp_path / "pad.toml").params()
    with pytest.raises(ConfigError, match=r"hand\.toml and command line:\s+texture\.max_tilt_deg"):
        Choices(config=config, max_tilt_deg=95.0).params()


@pytest.mark.parametrize("text", ["detect = 5", "[detect]\ntexture = 3", "[detect]\ngrip = 3"])
def test_a_value_in_place_of_a_table_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(text + "\n")
    with pytest.raises(ConfigError, match="should be a table"):
        Choices(config=tmp_path / "a.toml").params()


def test_an_array_of_a_configuration_lies_beside_it(tmp_path: Path) -> None:
    config = tmp_path / "hand.toml"
    config.write_text('[board]\narray = "./pad.toml"\n')
    assert Path(array_of_config(config)) == tmp_path / "pad.toml"
    config.write_text('[board]\narray = "normal-3x3"\n')
    assert array_of_config(config) == "normal-3x3"
    config.write_text('board = "hand"\n')
    with pytest.raises(ConfigError, match="board: should be a table"):
        array_of_config(config)


def test_the_calibration_of_a_recording_does_not_bind_another_layout(tmp_path: Path) -> None:
    calibrated = PipelineParams(force=True, calibration=load_calibration("wang2019-3x3"))
    encoder = Encoder(load_layout("legacy-9"))
    with RecordingWriter(
        tmp_path / "a.mcap", Header(load_board("board-v1", "wang2019-3x3"), calibrated)
    ) as writer:
        for number in range(100):
            scan = Scan(number, np.full(9, 100), 20 * number)
            writer.read(Read(10 + number / 50, 1.7e9, encoder.encode(scan)))
    assert detect_file(tmp_path / "a.mcap", choices=Choices(layout="legacy-9")).n_scans == 100


def test_a_log_of_one_scan_has_a_summary() -> None:
    assert said_of_a_pad(np.full((1, 16), 1000.0)) == ["1 scan: a rate and events need two or more"]


def test_the_summary_says_why_nothing_came(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a wrong zero nothing is a contact; without ripple nothing slides."""
    choices = Choices(time_unit="ms", columns=("tax*",))
    (tmp_path / "pad.toml").write_text(PAD.replace('"first 0.3 s"', "2600"))
    ridges_under_a_pad(tmp_path / "still.csv", ripple=0.0)
    log = detect_file(tmp_path / "still.csv", str(tmp_path / "pad.toml"), choices=choices)
    assert capsys.readouterr().out == ""
    said = " ".join(choices.summary(log))
    assert "no contact: is the zero right? --tare-s" in said
    assert "no texture: nothing slides; --sliding" in said


def test_a_slide_shows_though_the_zero_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    choices = Choices(time_unit="ms", columns=("tax*",))
    (tmp_path / "pad.toml").write_text(PAD.replace('"first 0.3 s"', "2600"))
    ridges_under_a_pad(tmp_path / "log.csv")
    log = detect_file(tmp_path / "log.csv", str(tmp_path / "pad.toml"), choices=choices)
    (slip,) = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert (slip["topic"], slip["detector"], slip["state"]) == ("slip", "sliding", "onset")
    assert abs(slip["onset"] - 0.75) < 2 * slip["onset_sd_s"]  # the load comes from 0.5 to 1 s, with ripple
    assert "no contact: is the zero right? --tare-s" in " ".join(choices.summary(log))


@pytest.mark.parametrize("reading", [1e300, -1e300, 38_000.0])
def test_readings_beyond_the_range_name_the_key_to_set(
    reading: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time_s, volts = press_and_slide(load_array("wang2019-3x3"), 100.0, 0.0)
    volts[41, 7] = reading
    volts[3] = np.nan  # a row without a reading is left out
    write_csv(tmp_path / "log.csv", time_s[:100], volts[:100])
    says = r'at 100\.41 s, channel 7: .* V, but .* -8 to 8 V; are these volts\? .*unit = "count" and range'
    with pytest.raises(DataError, match=says):
        detect_file(tmp_path / "log.csv")
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"choices": Choices(speed_mm_s=-5.0)}, "speed_mm_s: input should be greater than or equal to 0"),
        ({"choices": Choices(speed_mm_s=1e308)}, "speed_mm_s: input should be less than or equal to 1000"),
        ({"choices": Choices(speed_mm_s=float("nan"))}, "speed_mm_s: input should be a finite number"),
        ({"rate_hz": 1e30}, "rows are 0.01 s apart"),
        ({"rate_hz": float("inf")}, "rows are 0.01 s apart"),
        ({"rate_hz": float("nan")}, "rows are 0.01 s apart"),
        ({"plot": Path("/nonexistent/x.png")}, "a folder that exists"),
        ({"plot": Path("x.exe")}, r"name a \.png"),
        ({"path": Path("log.docx")}, r"unknown kind of file; known are .* or a folder\)$"),
        ({"path": Path("log.parquet")}, r'pandas\.read_parquet\("log\.parquet"\)\.to_csv\("log\.csv"'),
        ({"path": Path("none.mcap")}, "No such file"),
        ({"path": Path("log.mcap"), "array": "normal-4x4"}, "a recording contains its array"),
        ({"array": "normal-4x4"}, "36 channels, but array normal-4x4 has 16"),
        ({"array": "no-such-array"}, "no-such-array"),
        ({"choices": Choices(setting="fastest")}, "setting"),
    ],
)
def test_impossible_arguments_are_refused_before_anything_is_printed(
    arguments: dict[str, object],
    says: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    time_s, volts = press_and_slide(load_array("wang2019-3x3"), 100.0, 0.0)
    write_csv(tmp_path / "log.csv", time_s[:100], volts[:100])
    with pytest.raises((DataError, ConfigError), match=says):
        detect_file(**{"path": Path("log.csv"), **arguments})  # type: ignore[arg-type]
    assert capsys.readouterr().out == ""


def test_a_damaged_npz_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", time_s=np.arange(50) / 100, volts=np.zeros((50, 36)))
    whole = (tmp_path / "log.npz").read_bytes()
    for cut in range(0, len(whole), 997):
        (tmp_path / "cut.npz").write_bytes(whole[:cut])
        with pytest.raises(DataError, match=r"cut\.npz"):
            detect_file(tmp_path / "cut.npz")
    (tmp_path / "random.npz").write_bytes(np.random.default_rng(0).bytes(5000))
    with pytest.raises(DataError, match=r"random\.npz: not a complete npz file"):
        detect_file(tmp_path / "random.npz")
    objects = np.array([[None]], dtype=object)
    np.savez(tmp_path / "objects.npz", time_s=np.arange(50) / 100, volts=objects)
    with pytest.raises(DataError, match=r"objects\.npz: time_s and volts must be arrays of numbers"):
        detect_file(tmp_path / "objects.npz")
    np.savez(tmp_path / "complex.npz", time_s=np.arange(50) * 1j, volts=np.zeros((50, 36)))
    with pytest.raises(DataError, match=r"complex\.npz"):
        detect_file(tmp_path / "complex.npz")


def test_grip_lines_come_at_their_rate_and_at_changes_of_state(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_csv(tmp_path / "log.csv", *press_and_slide(load_array("wang2019-3x3"), 100.0, 30.0))
    detect_file(tmp_path / "log.csv", choices=Choices(grip_hz=5.0))
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    grips = [line for line in lines if line["topic"] == "grip"]
    assert [line["seq"] for line in grips] == list(range(len(grips)))
    for before, after in itertools.pairwise(grips):
        step_s = after["timestamp"] - before["timestamp"]
        assert step_s == pytest.approx(0.2, abs=1e-6) or (step_s < 0.2 and after["state"] != before["state"])
    # The log is in contact from 100.5 s or a little later to its end at 108 s.
    assert 35 <= len(grips) < 80
    detect_file(tmp_path / "log.csv", choices=Choices(grip_hz=0.0))
    others = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert others == [line for line in lines if line["topic"] != "grip"]


def test_a_recording_of_records_of_several_kinds_is_read_with_another_layout(tmp_path: Path) -> None:
    source, path = load_board("tsf-85-dynamic", "tsf-85-dynamic"), tmp_path / "tsf.mcap"
    scene = load_scene("rest").model_copy(update={"array": "tsf-85-dynamic"})
    board = EmulatedBoardParams(rate_hz=100.0)
    with RecordingWriter(path, Header(source)) as writer:
        for arrival_s, data in Simulation(scene, source.layout, board=board, duration_s=3.0):
            writer.read(Read(arrival_s, 0.0, data))
    dynamic = detect_file(path, choices=Choices(topics=("contact",)))
    static = detect_file(path, choices=Choices(topics=("contact",), layout="tsf-85"))
    n_scans, n_channels = dynamic.readings.shape
    assert n_channels == 2
    assert static.readings.shape[1] == 56
    assert n_scans == pytest.approx(100, abs=5)  # the first two seconds measure the rate
    assert abs(static.n_scans - n_scans) <= 1


@pytest.mark.parametrize(
    ("file", "array", "layout", "fault"),
    [
        ("a.mcap", "tsf-85", None, "--array is for tables, or beside --layout"),
        ("a.mcap", None, "board-v1", "--layout board-v1 needs --array"),
        ("a.csv", None, "tsf-85", "--layout is for our recordings"),
    ],
)
def test_a_layout_that_does_not_fit_is_refused(
    tmp_path: Path, file: str, array: str | None, layout: str | None, fault: str
) -> None:
    path = tmp_path / file
    if path.suffix == ".csv":
        path.touch()
    else:
        with RecordingWriter(path, Header(load_board("board-v1", "wang2019-3x3"))):
            pass
    with pytest.raises(ConfigError, match=fault):
        detect_file(path, array, choices=Choices(layout=layout))


def test_a_slide_outside_the_log_is_refused(tmp_path: Path) -> None:
    ridges_under_a_pad(tmp_path / "log.csv")
    (tmp_path / "pad.toml").write_text(PAD)
    choices = Choices(time_unit="ms", columns=("tax*",), sliding=KnownSliding(1200.0))
    with pytest.raises(
        DataError, match=r"--sliding lies outside the log, whose times are 0\.00019 to 8\.39695 s"
    ):
        detect_file(tmp_path / "log.csv", str(tmp_path / "pad.toml"), choices=choices)


@pytest.mark.parametrize(
    ("signs", "axes"), [((-1, 1), "x"), ((1, -1), "y"), ((-1, -1), "x and y"), ((1, 1), "")]
)
@pytest.mark.parametrize("n_dead", [0, 2])
def test_pads_whose_shear_cancels_are_named(signs: tuple[int, int], axes: str, n_dead: int) -> None:
    """One object between two fingers pulls both: pads that face each other have one axis the other way."""
    rng, pull = np.random.default_rng(0), np.sin(np.arange(100) / 5)
    pulls = np.column_stack([pull, np.roll(pull, 20)])
    pads = [np.repeat(pad, 2, axis=0).reshape(100, 4) for pad in (pulls, pulls * signs)]
    readings = np.hstack(pads) + rng.normal(0, 0.1, (100, 8))
    readings[:, :n_dead] = np.nan
    table = {
        "name": "fingers",
        "grids": [{"x_mm": [0.0, 2.0], "y_mm": [0.0]}] * 2,
        "taxel_channels": [{"name": "x", "kind": "shear_x"}, {"name": "y", "kind": "shear_y"}],
    }
    array = build(parse(table, ArrayFile, "fingers"))
    tally = log_summary.LogTally(array, "log")
    tally.add_scans(np.arange(100) / 50, readings)
    said = list(log_summary.summary(tally, ("slip",), 0.0, sliding_is_given=False))
    opposed = [line for line in said if line.startswith("shear of pad 1 opposes that of pad 0 along ")]
    assert [line.split(" along ")[1].split(",")[0] for line in opposed] == ([axes] if axes else [])


@pytest.mark.parametrize(("zero", "is_said"), [(0.0, True), (500.0, False), ("first 0.3 s", False)])
def test_a_log_that_begins_far_from_the_zero_of_its_array_is_said(zero: float | str, is_said: bool) -> None:
    table = tomllib.loads(PAD) | {"zero": zero}
    tally = log_summary.LogTally(build(parse(table, ArrayFile, "pad")), "log")
    readings = 500.0 + np.random.default_rng(0).normal(0, 1.0, (100, 16))
    readings[50:, 3] += 300.0
    readings[:30, 5] = np.nan  # has no reading at the beginning
    tally.add_scans(np.arange(100) / 100, readings)
    said = list(log_summary.summary(tally, ("slip",), 0.0, sliding_is_given=False))
    assert any("far from the `zero` of the array: 15, by up to" in line for line in said) == is_said
    assert any("begin far from the" in line for line in said) == is_said


def test_the_memory_of_a_tally_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_summary, "_MOST_VALUES", 1600)
    tally = log_summary.LogTally(build(parse(tomllib.loads(PAD), ArrayFile, "pad")), "log")
    time_s, readings = np.arange(100_000) / 100, np.broadcast_to(1000.0, (100_000, 16))
    tracemalloc.start()
    tally.add_scans(time_s, readings)
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak_bytes < 2e6
    assert tally.n_scans == 100_000
    assert tally.spacing_s == pytest.approx(0.01)


def said_of_a_pad(readings: FloatArray) -> list[str]:
    """Lines on a log of 16 pressures in counts, whose zero are its first 0.3 s."""
    tally = log_summary.LogTally(build(parse(tomllib.loads(PAD), ArrayFile, "pad")), "log")
    tally.add_scans(np.arange(len(readings)) / 36, readings)
    return list(log_summary.summary(tally, ("contact",), 0.0, sliding_is_given=False))


@pytest.mark.parametrize(("n_lost", "is_named"), [(0, False), (5, False), (40, True), (300, False)])
def test_channels_that_come_up_after_the_zero_are_named(n_lost: int, is_named: bool) -> None:
    readings = 1000 + np.random.default_rng(0).normal(0, 2, (300, 16))
    readings[:n_lost, [3, 7]] = np.nan
    said = [line for line in said_of_a_pad(readings) if "no valid reading in the first 0.3 s" in line]
    assert [line.startswith("channels [3, 7] ") for line in said] == [True] * is_named


@pytest.mark.parametrize("begins_pressed", [True, False])
def test_a_zero_that_was_taken_under_load_is_named(begins_pressed: bool) -> None:
    load = np.where((np.arange(300) < 100) == begins_pressed, 300.0, 0.0)
    readings = 1000 + load[:, np.newaxis] + np.random.default_rng(0).normal(0, 2, (300, 16))
    said = said_of_a_pad(readings)
    assert ("was the sensor touched in the first 0.3 s?" in " ".join(said)) == begins_pressed
    zeros = re.findall(r"zero = \[([0-9.]+), ", " ".join(said))
    assert [round(float(zero), -1) for zero in zeros] == ([1000.0] if begins_pressed else [])
    assert not any("--tare-s" in line for line in said)  # the zero is taken from the beginning already


def test_channels_that_fall_under_load_are_named_before_a_zero_under_load() -> None:
    """The log begins and ends without a load."""
    load = np.where((np.arange(300) > 100) & (np.arange(300) < 200), 300.0, 0.0)
    readings = 1000 - load[:, np.newaxis] + np.random.default_rng(0).normal(0, 2, (300, 16))
    (said,) = [line for line in said_of_a_pad(readings) if line.startswith("pressure falls to")]
    assert said.index("`sign = -1`") < said.index("zero = [")


def test_saturated_readings_at_the_beginning_are_no_zero_taken_under_load() -> None:
    readings = 1000 + np.random.default_rng(0).normal(0, 2, (300, 16))
    readings[:8] = 4095.0  # of the 11 scans that give the zero
    assert not any("was the sensor touched" in line for line in said_of_a_pad(readings))


@pytest.mark.parametrize(
    ("value", "said"), [(np.nan, "; 8 missing"), (4095.0, "; 8 saturated, and not used")]
)
def test_readings_that_are_not_used_are_counted_by_cause(value: float, said: str) -> None:
    readings = 1000 + np.random.default_rng(0).normal(0, 2, (300, 16))
    readings[100:108, 3] = value
    (line,) = [line for line in said_of_a_pad(readings) if "of the range" in line]
    assert line.split("of the range")[1].startswith(said)
    assert ("widen `range`" in line) == (value == 4095.0)
