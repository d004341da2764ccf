"""Bytes to events: the laws of the whole path, on bytes that the emulator sends."""

import dataclasses
import functools
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled import resources
from tactiled.array import Array, load_array
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectParams
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultAt, FaultParams
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.truth import Truth
from tactiled.emulator.simulate import Simulation
from tactiled.events.types import (
    ContactEvent,
    Event,
    ForceEvent,
    GripEvent,
    ScanEvent,
    SlipEvent,
    TextureEvent,
)
from tactiled.force.calibration import load_calibration
from tactiled.pipeline import Pipeline, PipelineParams, check_hello
from tactiled.received import Output
from tactiled.samples.assembler import SampleParams
from tactiled.samples.block import ScanBlock
from tactiled.tomlfile import parse
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Acknowledge, Hello, Scan
from tactiled.wire.layout import load_layout

LAYOUT = load_layout("board-v1")
ARRAY = load_array("wang2019-3x3")
# The published methods count scans: stamps, which differ with the reads, change nothing that they find.
PARAMS = PipelineParams(detect=DetectParams(setting="wang2019", texture=JointParams(speed_mm_s=4.0)))


@functools.cache
def scene() -> Scene:
    document = {
        "name": "short",
        "surface": {"kind": "grooves", "period_mm": 1.2, "angle_deg": 20.0},
        "phases": [
            {"kind": "rest", "duration_s": 0.3},
            {"kind": "press", "duration_s": 1.0, "force_n": 20.0},
            {"kind": "hold", "duration_s": 1.2},
            {"kind": "slide", "duration_s": 12.0, "speed_mm_s": 4.0},
            {"kind": "lift", "duration_s": 0.5},
        ],
    }
    return parse(document, Scene, "test")


@functools.cache
def stream(faults: FaultParams | None = None) -> tuple[tuple[float, bytes], ...]:
    return tuple(Simulation(scene(), LAYOUT, faults=faults, seed=3))


def pipeline() -> Pipeline:
    return Pipeline(LAYOUT, ARRAY, PARAMS)


def outputs(reads: tuple[tuple[float, bytes], ...], params: PipelineParams = PARAMS) -> list[object]:
    target = Pipeline(LAYOUT, ARRAY, params)
    return [out for now_s, data in reads for out in target.receive_data(data, now_s)]


@functools.cache
def whole() -> list[object]:
    """Return what comes of the stream without faults, read by read."""
    return outputs(stream())


def test_a_press_a_slip_and_a_texture_come_out() -> None:
    out = whole()
    assert isinstance(out[0], Hello)
    states = [e.state for e in out if isinstance(e, ContactEvent)]
    assert states[:3] == ["loading", "holding", "sliding"]
    assert states[-1] == "none"
    assert [e.state for e in out if isinstance(e, SlipEvent)] == ["onset", "end"]
    texture = next(e for e in out if isinstance(e, TextureEvent) and e.status in ("ok", "ambiguous"))
    assert texture.frequency_hz == pytest.approx(4.0 * np.cos(np.radians(20)) / 1.2, abs=1 / 3.0)
    assert any(isinstance(e, Acknowledge) and e.result == "ok" for e in out)


@settings(max_examples=8, deadline=None)
@given(cuts=st.lists(st.integers(1, 400), min_size=1, max_size=40))
def test_any_split_of_the_bytes_gives_bit_identical_output(cuts: list[int]) -> None:
    """A part that completes no frame may come at any time; what completes one keeps its arrival."""
    sizes = itertools.cycle(cuts)
    parts: list[tuple[float, bytes]] = []
    for now_s, data in stream():
        while data:
            size = next(sizes)
            parts.append((now_s, data[:size]))
            data = data[size:]
    assert outputs(tuple(parts)) == whole()


def test_events_do_not_depend_on_how_many_scans_come_at_once() -> None:
    """Fifty scans in one read, or all: the same events at the same scans (stamps differ, scans do not)."""
    # Scans that wait for others are late; whether they count must not differ here.
    patient = PARAMS.model_copy(update={"samples": SampleParams(late_after_s=1e6)})

    def facts(reads: tuple[tuple[float, bytes], ...]) -> list[object]:
        out = outputs(reads, patient)
        stamps = [e.time_s for e in out if isinstance(e, ScanEvent)]

        def at(time_s: float) -> int:
            return int(np.argmin(np.abs(np.array(stamps) - time_s)))

        found: list[object] = [type(e).__name__ for e in out if isinstance(e, Event)]
        for e in out:
            if isinstance(e, SlipEvent):
                found.append((e.state, e.direction_deg, e.statistic, e.taxels, at(e.detected_s)))
            elif isinstance(e, ContactEvent):
                found.append((e.state, e.taxels, at(e.time_s)))
            elif isinstance(e, TextureEvent):
                found.append((e.status, e.period_mm, e.angle_deg, e.frequency_hz, e.snr_db))
        return found

    single = stream()
    assert facts(single) == facts(_merged(single, 50)) == facts(_merged(single, 700))


def _merged(reads: tuple[tuple[float, bytes], ...], n: int) -> tuple[tuple[float, bytes], ...]:
    return tuple(
        (reads[min(k + n, len(reads)) - 1][0], b"".join(data for _, data in reads[k : k + n]))
        for k in range(0, len(reads), n)
    )


def test_reset_equals_new() -> None:
    used = pipeline()
    for now_s, data in stream()[:400]:
        used.receive_data(data, now_s)
    used.reset()
    again = [out for now_s, data in stream() for out in used.receive_data(data, now_s)]
    assert again == whole()


FAULTY = FaultParams(
    flip_per_byte=2e-4,
    drop_per_byte=1e-4,
    cut_per_frame=0.01,
    duplicate_per_frame=0.02,
    burst_per_s=0.2,
    at=[FaultAt(kind="stall", at_s=3.0), FaultAt(kind="reboot", at_s=5.0), FaultAt(kind="overrun", at_s=2.0)],
)


@pytest.mark.parametrize("seed", range(5))
def test_every_scan_the_board_took_is_accounted_for(seed: int) -> None:
    target = pipeline()
    simulation = Simulation(scene(), LAYOUT, faults=FAULTY, seed=seed)
    events: list[Event] = []
    for now_s, data in simulation:
        events += [out for out in target.receive_data(data, now_s) if isinstance(out, Event)]
    health = target.health()
    assert health.bytes_in == health.bytes_framed + health.bytes_discarded + health.bytes_pending
    assert health.scans == sum(isinstance(e, ScanEvent) for e in events)
    # Scans before the first that arrived, and after the last, of each boot cannot be seen to be missing.
    by_boot: dict[int, int] = {}
    for scan in simulation.scans:
        by_boot[scan.boot] = by_boot.get(scan.boot, 0) + 1
    total = sum(by_boot.values())
    known = health.scans + health.scans_missing
    assert total - 30 * len(by_boot) <= known <= total
    assert health.scans_duplicate > 0
    assert health.frames_corrupt > 0


def test_delivered_counts_are_what_the_board_measured() -> None:
    """Damage never turns into other voltages: each delivered scan is one that a clean line delivers."""
    clean = {e.volts for e in whole() if isinstance(e, ScanEvent)}
    faults = FaultParams(flip_per_byte=5e-4, drop_per_byte=5e-4, duplicate_per_frame=0.05)
    target = pipeline()
    got = [
        out.volts
        for now_s, data in Simulation(scene(), LAYOUT, faults=faults, seed=1)
        for out in target.receive_data(data, now_s)
        if isinstance(out, ScanEvent)
    ]
    assert len(got) > 300
    assert set(got) <= clean


def test_backlog_behind_a_stall_raises_no_fresh_slip() -> None:
    """The slip happens inside a stall of 0.5 s: it is said, and marked as not fresh."""
    onset_s = 2.55  # after power-up: boot, rest, press, hold
    faults = FaultParams(at=[FaultAt(kind="stall", at_s=onset_s - 0.02)])
    target = pipeline()
    slips = [
        out
        for now_s, data in Simulation(scene(), LAYOUT, faults=faults)
        for out in target.receive_data(data, now_s)
        if isinstance(out, SlipEvent) and out.state == "onset"
    ]
    assert [slip.valid for slip in slips] == [False]


def test_a_wrong_board_is_reported_and_its_scans_are_not_published() -> None:
    board = EmulatedBoardParams(array_id="other-array")
    out: list[object] = []
    target = pipeline()
    for now_s, data in Simulation(scene(), LAYOUT, board=board, duration_s=1.0):
        out += target.receive_data(data, now_s)
    assert [type(o) for o in out if isinstance(o, Event)] == []
    hello = next(o for o in out if isinstance(o, Hello))
    reason = check_hello(hello, LAYOUT, ARRAY)
    assert reason is not None
    assert "other-array" in reason
    assert "board.array" in reason
    for rate_hz in (0.001, 4e6, float("nan")):
        assert "possible are 0.1 to 20000 Hz" in str(
            check_hello(dataclasses.replace(hello, array_id=ARRAY.name, rate_hz=rate_hz), LAYOUT, ARRAY)
        )
    newer = dataclasses.replace(hello, protocol_version=2, array_id=ARRAY.name)
    assert "protocol version 2" in str(check_hello(newer, LAYOUT, ARRAY))


def test_disconnecting_drops_partial_frames_and_gives_a_gap() -> None:
    target = pipeline()
    reads = stream()
    for now_s, data in reads[:200]:
        target.receive_data(data, now_s)
    target.receive_data(reads[200][1][:30], reads[200][0])
    target.disconnected()
    health = target.health()
    assert health.bytes_pending == 0
    assert health.bytes_in == health.bytes_framed + health.bytes_discarded
    assert target.hello is None


@pytest.mark.parametrize("force", [False, True])
def test_scans_of_long_ago_are_no_zero(force: bool) -> None:
    target = pipeline()
    for now_s, data in stream()[:40]:
        target.receive_data(data, now_s)
    newest_s = target.health().newest_scan_s
    assert (
        target.command("tare", {"force": force}, newest_s + 3600.0)[0]
        == "no new scans: is the board plugged in?"
    )
    assert "no new scans" not in target.command("tare", {"force": force}, newest_s + 0.5)[0]


def test_another_layout_needs_no_code() -> None:
    """Big-endian, sync word, CRC-32, nine channels, no hello and no commands."""
    layout = load_layout("legacy-9")
    rest = load_scene("rest").with_changes(array="normal-3x3")
    target = Pipeline(layout, load_array("normal-3x3"))
    simulation = Simulation(rest, layout, duration_s=30.0)
    scans = [
        out
        for now_s, data in simulation
        for out in target.receive_data(data, now_s)
        if isinstance(out, ScanEvent)
    ]
    assert len(scans) == pytest.approx(len(simulation.scans), abs=2)
    assert len(scans) > 1400
    assert target.health().scans_missing == 0
    assert len(scans[0].volts) == 9


def in_unit(tmp_path: Path, unit: str) -> Array:
    """The 2019 array, described with readings in another unit."""
    text = resources.shipped("config", "arrays", "wang2019-3x3.toml").read_text()
    text = text[: text.index("# Pressure responses")]
    path = tmp_path / "own.toml"
    name = 'name = "wang2019-3x3"'
    path.write_text(text.replace(name, f'{name}\nunit = "{unit}"\nrange = [0, 4095]'))
    return load_array(str(path))


def in_volts_and_counts(tmp_path: Path) -> list[list[Any]]:
    """What the same bytes give to the array in volts and to that in counts."""
    layout, simulation = load_layout("board-v1"), Simulation(load_scene("demo"), LAYOUT, duration_s=8.0)
    reads = list(simulation)
    pipelines = (
        Pipeline(layout, array) for array in (load_array("wang2019-3x3"), in_unit(tmp_path, "count"))
    )
    return [[out for now_s, data in reads for out in one.receive_data(data, now_s)] for one in pipelines]


def test_an_array_in_counts_gets_the_counts_of_the_board(tmp_path: Path) -> None:
    """Readings are whole counts, and slips are those of the same array in volts."""
    found = in_volts_and_counts(tmp_path)
    scans = [[e for e in events if isinstance(e, ScanEvent)] for events in found]
    volts, counts = (np.array([scan.volts for scan in some]) for some in scans)
    assert (counts == np.rint(counts)).all()
    assert counts * 3.0 / 4096 == pytest.approx(volts)
    in_volts, in_counts = ([e for e in events if isinstance(e, SlipEvent)] for events in found)
    assert [(e.state, e.kind) for e in in_volts] == [(e.state, e.kind) for e in in_counts] != []
    for one, other in zip(in_volts, in_counts, strict=True):  # both are rounded, to other steps
        assert other.onset_s == pytest.approx(one.onset_s, abs=one.onset_sd_s)
    first, second = ({e.time_s: e.p_sliding for e in some if isinstance(e, GripEvent)} for some in found)
    errors = np.array([abs(first[time_s] - second[time_s]) for time_s in first.keys() & second.keys()])
    assert len(errors) > 600
    assert (errors > 0.1).mean() < 0.01


def test_an_array_in_counts_has_its_slips_when_that_in_volts_has_them(tmp_path: Path) -> None:
    in_volts, in_counts = (
        [e.detected_s for e in events if isinstance(e, SlipEvent)] for events in in_volts_and_counts(tmp_path)
    )
    assert in_counts == pytest.approx(in_volts, abs=0.02)


def hello_of_board() -> Hello:
    return next(
        out
        for now_s, data in Simulation(load_scene("rest"), LAYOUT, duration_s=1.0)
        for out in Pipeline(LAYOUT, ARRAY).receive_data(data, now_s)
        if isinstance(out, Hello)
    )


@pytest.mark.parametrize("unit", ["count", "V"])
def test_full_scale_is_rest_where_readings_fall_under_load(unit: str, tmp_path: Path) -> None:
    falls = np.arange(36) % 2 == 1
    array = load_array("wang2019-3x3") if unit == "V" else in_unit(tmp_path, unit)
    encoder, hello = Encoder(LAYOUT), hello_of_board()
    full = [
        encoder.encode(Scan(sequence=k, ticks=200 * k, flags=0, counts=np.full(36, 4095, dtype=np.int64)))
        for k in range(3)
    ]
    reads = [encoder.encode(hello) + full[0], full[1] + full[2]]  # a scan alone is converted another way
    target = Pipeline(LAYOUT, dataclasses.replace(array, sign=np.where(falls, -1.0, 1.0)))
    found = [event for k, data in enumerate(reads) for event in target.receive_data(data, 1.0 + 0.02 * k)]
    scans = [event for event in found if isinstance(event, ScanEvent)]
    assert len(scans) == 3
    for scan in scans:
        assert scan.volts == pytest.approx(
            (4095.0 if unit == "count" else 4095 * hello.volts_per_count,) * 36
        )
        assert scan.valid == tuple(falls.tolist())


@pytest.mark.parametrize("unit", ["count", "V"])
def test_readings_beyond_the_range_of_the_array_are_not_valid_as_in_a_log(unit: str, tmp_path: Path) -> None:
    encoder, hello = Encoder(LAYOUT), hello_of_board()
    per_count = 1.0 if unit == "count" else hello.volts_per_count
    array = dataclasses.replace(in_unit(tmp_path, unit), low=100 * per_count, high=3000 * per_count)
    counts = np.resize([0, 99, 100, 2999, 3000, 4095], 36)
    data = encoder.encode(hello) + encoder.encode(Scan(sequence=0, ticks=0, flags=0, counts=counts))
    (scan,) = (e for e in Pipeline(LAYOUT, array).receive_data(data, 1.0) if isinstance(e, ScanEvent))
    assert scan.valid == tuple(array.in_range(counts * per_count).tolist())
    assert scan.valid[:6] == (False, False, True, True, False, False)


def test_a_board_of_counts_does_not_fit_an_array_in_another_unit(tmp_path: Path) -> None:
    fault = check_hello(hello_of_board(), LAYOUT, in_unit(tmp_path, "N"))
    assert fault is not None
    assert "reads N" in fault
    assert "in V or count" in fault


def spoiled_reads() -> list[tuple[bytes, float]]:
    """Reads of a touch with lost and damaged bytes, long and short gaps, and several frames in some reads."""
    reads = [(data, arrival_s) for arrival_s, data in stream()]
    for k in (250, 251, 300, *range(600, 640), 770):
        reads[k] = (b"", reads[k][1])
    reads[500] = (bytes(255 - byte for byte in reads[500][0]), reads[500][1])
    for k in range(700, 760, 3):  # three frames come with the last of them
        reads[k : k + 3] = [(b"", reads[k][1]), (b"", reads[k + 1][1]), joined(reads[k : k + 3])]
    return reads


def joined(reads: list[tuple[bytes, float]]) -> tuple[bytes, float]:
    return b"".join(data for data, _ in reads), reads[-1][1]


@pytest.mark.parametrize("size", [2, 37, 1000])
def test_many_reads_at_once_give_each_the_outputs_of_one_at_a_time(size: int) -> None:
    reads = spoiled_reads()
    single, many, blocks = (Pipeline(LAYOUT, ARRAY) for _ in range(3))
    wanted = [single.receive_data(data, now_s) for data, now_s in reads]
    found: list[list[Output]] = []
    events: list[Event] = []
    n_scans = 0
    for start in range(0, len(reads), size):
        part = reads[start : start + size]
        found += many.detect([many.receive(data, now_s) for data, now_s in part])
        for detected in blocks.process([blocks.receive(data, now_s) for data, now_s in part]):
            n_scans += len(detected.item) if isinstance(detected.item, ScanBlock) else 0
            events += detected.events
    assert found == wanted
    assert any(isinstance(output, SlipEvent) for outputs in wanted for output in outputs)
    everything = [output for outputs in wanted for output in outputs]
    scans = [output for output in everything if isinstance(output, ScanEvent)]
    assert n_scans == len(scans) > 600
    assert many.health() == single.health() == blocks.health()
    assert [e for e in events if isinstance(e, SlipEvent | ContactEvent)] == [
        e for e in everything if isinstance(e, SlipEvent | ContactEvent)
    ]


@pytest.mark.parametrize("size", [1, 3])
def test_the_scans_of_a_read_are_known_before_the_detectors_run(size: int) -> None:
    target = pipeline()
    reads = spoiled_reads()
    n_scans = 0
    for k in range(0, len(reads), size):
        received = target.receive(*joined(reads[k : k + size]))
        scans = list(received.scan_events)
        assert [out for out in target.detect([received])[0] if isinstance(out, ScanEvent)] == scans
        n_scans += len(scans)
    assert n_scans == target.health().scans > 600


@pytest.mark.parametrize("size", [37, 1000])
def test_many_reads_at_once_equal_single_ones_while_the_first_scans_give_the_zero(size: int) -> None:
    """Events of scans that are held back come with the scan that completes the zero."""
    reads = spoiled_reads()[:200]
    array = dataclasses.replace(ARRAY, zero_first_s=0.3)
    single, many = (Pipeline(LAYOUT, array, PipelineParams(force=True)) for _ in range(2))
    wanted = [single.receive_data(data, now_s) for data, now_s in reads]
    found: list[list[Output]] = []
    for start in range(0, len(reads), size):
        found += many.detect([many.receive(data, now_s) for data, now_s in reads[start : start + size]])
    assert found == wanted
    assert max(sum(isinstance(out, ForceEvent) for out in outputs) for outputs in wanted) == 30


def test_late_fits_are_those_of_the_newest_read_also_where_a_detector_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    target, reads = pipeline(), spoiled_reads()
    for data, now_s in reads[:50]:
        target.receive_data(data, now_s)
    late = iter([[7], [8]])
    monkeypatch.setattr(target.tuning, "take_late_fits", lambda: next(late))
    target.receive_data(*reads[50])
    assert target.late_fits == [7]
    received = target.receive(*reads[51])
    assert target.late_fits == []

    def fail(_item: object) -> list[Event]:
        raise ZeroDivisionError

    monkeypatch.setattr(target.tuning, "process", fail)
    with pytest.raises(ZeroDivisionError):
        target.detect([received])
    assert target.late_fits == [8]


def test_events_of_each_scan_have_all_their_fields() -> None:
    params = PipelineParams(force=True, calibration=load_calibration(ARRAY.name))
    pipeline = Pipeline(LAYOUT, ARRAY, params)
    events = [out for data, now_s in spoiled_reads()[:60] for out in pipeline.receive_data(data, now_s)]
    for kind in (ScanEvent, ForceEvent):
        found = [event for event in events if isinstance(event, kind)]
        assert len(found) > 30
        for event in found:
            assert event == kind(**vars(event))
            assert set(vars(event)) == {field.name for field in dataclasses.fields(kind)}


@functools.cache
def reads_of_stick_and_slip() -> list[tuple[float, bytes]]:
    return list(Simulation(load_scene("stick-slip"), LAYOUT))


@functools.cache
def onsets_of_stick_and_slip(setting: str) -> list[SlipEvent]:
    target = Pipeline(LAYOUT, ARRAY, PipelineParams(detect=DetectParams(setting=setting)))
    return [
        event
        for now_s, data in reads_of_stick_and_slip()
        for event in target.receive_data(data, now_s)
        if isinstance(event, SlipEvent) and event.state == "onset"
    ]


def test_each_slip_of_stick_and_slip_goes_the_same_way() -> None:
    """Between two slides shear falls and grows again; only its growth tells where the next one goes."""
    found = onsets_of_stick_and_slip("fast")
    assert [slip.kind for slip in found].count("gross") >= 4
    assert max(abs(slip.direction_deg) for slip in found) < 10.0


@pytest.mark.parametrize("setting", ["fast", "balanced"])
@pytest.mark.xfail(
    strict=True,
    raises=AssertionError,
    reason="4 and 1 of 7: probabilities rise more slowly than a slide of 50 ms",
)
def test_each_slide_of_stick_and_slip_is_a_gross_slip(setting: str) -> None:
    kinds = [slip.kind for slip in onsets_of_stick_and_slip(setting)]
    assert kinds.count("gross") == len(Truth(load_scene("stick-slip")).slips)


def test_a_line_whose_rate_is_below_zero_is_weighed_as_any_other() -> None:
    """On a flat plate, noise is at times taken for a slow ripple, which the fit refines to below zero."""
    detect = DetectParams.model_validate({"texture": {"speed_mm_s": 1.0}})
    target = Pipeline(LAYOUT, ARRAY, PipelineParams(detect=detect))
    simulation = Simulation(load_scene("demo").with_changes(seed=14), LAYOUT, duration_s=12.6)
    found = [event for now_s, data in simulation for event in target.receive_data(data, now_s)]
    assert any(isinstance(event, SlipEvent) and event.kind == "gross" for event in found)
    assert not any(isinstance(event, TextureEvent) and event.status == "ok" for event in found)


def test_text_between_the_lines_of_a_board_does_not_prevent_the_measurement_of_its_rate() -> None:
    target = Pipeline(load_layout("load-cell"), load_array("load-cell"))
    reads = [
        (b"# 21 degrees\n" if number % 100 == 50 else b"") + f"{number % 7}\n".encode()
        for number in range(500)
    ]
    found = [out for number, data in enumerate(reads) for out in target.receive_data(data, 5 + number / 100)]
    (hello,) = [out for out in found if isinstance(out, Hello)]
    assert hello.rate_hz == pytest.approx(100.0, rel=0.01)
