"""Period without an angle: lines of known frequency, noise of any colour, intervals that hold."""

import dataclasses

import numpy as np
import pytest
from gratings import ARRAY as GRATED
from gratings import Grating, Slide, known
from hypothesis import given, settings
from slips import slip_at
from touches import pieces, splits, textures

from tactiled.array import Array, FloatArray, build, load_array
from tactiled.detect.grooves.estimator import JointTexture
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import Outcome, PeriodOnly, Refusal
from tactiled.detect.grooves.params import JointParams, WaveParams
from tactiled.detect.grooves.period_only import fit_line, fit_wave_or_line, period_range, spectral_lines
from tactiled.detect.grooves.swings import swing_spectrum
from tactiled.detect.grooves.window import FitWindow
from tactiled.detect.signal.slip_gate import KnownSliding
from tactiled.detect.sliding.sliding_detector import LOOKS_BACK_S
from tactiled.detect.suite import DetectParams, Suite, build_suite
from tactiled.events.types import Candidate, Event, TextureEvent, TextureStatus
from tactiled.samples.block import Gap, ScanBlock, regular_block
from tactiled.tomlfile import parse

RATE_HZ = 35.6
NOWHERE = load_array("normal-4x4")


def unknown_places(n: int) -> Array:
    from tactiled.array import ArrayFile

    channel = {"name": "N", "kind": "normal"}
    document = {"name": "pad", "unit": "count", "range": [0, 4095], "zero": 2000, "taxel_count": n}
    return build(parse({**document, "taxel_channels": [channel]}, ArrayFile, "test"))


def coloured(rng: np.random.Generator, n: int, channels: int, slope: float) -> FloatArray:
    frequency = np.maximum(np.fft.rfftfreq(n), 1 / n)[:, np.newaxis]
    spectrum = np.fft.rfft(rng.standard_normal((n, channels)), axis=0) * frequency ** (-slope / 2)
    noise = np.fft.irfft(spectrum, n, axis=0)
    return np.asarray(noise / noise.std(axis=0))


def ridges(
    seed: int, lines: dict[float, float], seconds: float = 8.0, channels: int = 16, slope: float = 1.0
) -> ScanBlock:
    """Readings with ripples of some frequencies (Hz) and amplitudes in standard deviations of the noise."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE_HZ)
    time_s = np.arange(n) / RATE_HZ
    readings = coloured(rng, n, channels, slope)
    for frequency_hz, amplitude in lines.items():
        phase = 2 * np.pi * frequency_hz * time_s[:, np.newaxis] + rng.uniform(0, 6.3, channels)
        readings += amplitude * rng.uniform(0.5, 1.5, channels) * np.cos(phase)
    return regular_block(2000 + 20 * readings, RATE_HZ)


def answers(array: Array, items: list[ScanBlock | Gap], **texture: object) -> list[TextureEvent]:
    suite = build_suite(array, DetectParams.model_validate({"texture": texture}), sliding=KnownSliding())
    events = [event for item in items for event in suite.process(item)]
    return [event for event in events if isinstance(event, TextureEvent)]


@pytest.mark.parametrize("seed", range(8))
def test_a_line_is_found_at_its_frequency_within_its_sigma(seed: int) -> None:
    true_hz = float(np.random.default_rng(100 + seed).uniform(1.5, 14))
    block = ridges(seed, {true_hz: 1.0})
    line = spectral_lines(swing_spectrum(block.volts), block.time_s, (0.0, 16.0))[0]
    assert abs(line.frequency_hz - true_hz) < 4 * line.frequency_sd_hz
    assert line.frequency_sd_hz < 0.01


@pytest.mark.parametrize("slope", [0.0, 1.0, 2.0])
@pytest.mark.parametrize("channels", [1, 16])
def test_noise_of_any_even_colour_has_no_line(slope: float, channels: int) -> None:
    found = 0
    for seed in range(40):
        block = ridges(1000 + seed, {}, channels=channels, slope=slope)
        found += bool(spectral_lines(swing_spectrum(block.volts), block.time_s, (0.0, 16.0)))
    assert found == 0


def test_degenerate_windows_have_no_line_and_no_warning() -> None:
    time_s = np.arange(200) / 100
    flat = np.full((200, 4), 7.0)
    assert spectral_lines(swing_spectrum(flat), time_s, (0.0, 45.0)) == []
    straight = flat + 100 * time_s[:, np.newaxis]
    assert spectral_lines(swing_spectrum(straight), time_s, (0.0, 45.0)) == []
    assert spectral_lines(swing_spectrum(flat[:20]), time_s[:20], (0.0, 45.0)) == []
    one_bit = flat + np.where(np.arange(200) % 50 == 0, 1.0, 0.0)[:, np.newaxis]
    for line in spectral_lines(swing_spectrum(one_bit), time_s, (0.0, 45.0)):
        assert np.isfinite(line).all()


def test_a_known_speed_gives_the_period_as_an_interval() -> None:
    found = answers(unknown_places(16), [ridges(1, {4.0: 1.0})], speed_mm_s=10.0, max_tilt_deg=30.0)
    assert found
    assert {event.status for event in found} == {"period-only"}
    last = found[-1]
    assert last.period_mm == pytest.approx(2.5, abs=4 * last.period_sd_mm)
    assert last.period_sd_mm < 0.01
    assert (last.angle_sd_deg, last.speed_source) == (180.0, "given")
    shortest, longest = period_range(last.frequency_hz, 10.0, 30.0)
    assert last.period_min_mm == pytest.approx(shortest - 2 * last.period_sd_mm)
    assert last.period_max_mm == pytest.approx(longest + 2 * last.period_sd_mm)
    assert shortest == pytest.approx(2.5 * np.cos(np.radians(30)), rel=0.01)


def test_the_interval_ends_at_the_permitted_periods() -> None:
    found = answers(
        unknown_places(16),
        [ridges(1, {4.0: 1.0})],
        speed_mm_s=10.0,
        max_tilt_deg=75.0,
        min_period_mm=1.0,
        max_period_mm=2.0,
    )
    event = found[-1]
    assert (event.status, event.period_mm) == ("period-only", 2.0)
    assert (event.period_min_mm, event.period_max_mm) == (1.0, 2.0)


def test_known_places_without_shear_answer_too() -> None:
    block = ridges(2, {4.0: 1.0}, seconds=5.0)
    readings = 1.0 + (block.volts - 2000) / 1000
    found = answers(NOWHERE, [regular_block(readings, RATE_HZ)], speed_mm_s=10.0)
    assert found[-1].status == "period-only"
    assert found[-1].period_mm == pytest.approx(2.5, rel=0.005)


def test_without_a_speed_the_frequency_alone_is_stated() -> None:
    found = answers(unknown_places(16), [ridges(3, {4.0: 1.0}, seconds=9.0)])
    assert {(event.status, event.period_mm) for event in found} == {("ambiguous", 0.0)}
    assert found[-1].frequency_hz == pytest.approx(4.0, abs=0.02)


def test_several_gratings_are_all_reported_and_harmonics_are_none() -> None:
    lines = {3.0: 1.2, 6.0: 0.6, 4.6: 0.8}  # the second one is a harmonic of the first
    last = answers(unknown_places(16), [ridges(4, lines)], speed_mm_s=6.0)[-1]
    assert [c.period_mm for c in last.candidates] == pytest.approx([2.0, 6.0 / 4.6], rel=0.01)
    for grating, true_mm in zip(last.candidates, (2.0, 6.0 / 4.6), strict=True):
        assert abs(grating.period_mm - true_mm) < 4 * grating.period_sd_mm
        assert grating.period_min_mm < true_mm < grating.period_max_mm
    assert last.candidates[0].weight > last.candidates[1].weight
    assert last.period_mm == last.candidates[0].period_mm
    harmonic = answers(unknown_places(16), [ridges(5, {3.0: 0.7, 6.0: 1.0})], speed_mm_s=6.0)[-1]
    assert harmonic.frequency_hz == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize("frequency_hz", [55.0, 60.0, 70.0, 90.0])
def test_the_period_of_an_undersampled_ripple_is_not_stated(frequency_hz: float) -> None:
    slide = Slide((Grating(0.8, 10.0),), speed_mm_s=0.8 * frequency_hz / np.cos(np.radians(10.0)))
    offsets_s, layout = np.zeros(GRATED.n_channels), channel_layout(GRATED)
    window = FitWindow(slide.volts(GRATED), slide.times(), offsets_s, layout, known(slide), WaveParams())
    assert fit_wave_or_line(window).status == "aliased"


def test_lines_outside_the_permitted_periods_are_no_grooves() -> None:
    found = answers(
        unknown_places(16), [ridges(6, {9.0: 1.0})], speed_mm_s=6.0, min_period_mm=1.0, max_period_mm=4.0
    )
    assert "period-only" not in {event.status for event in found}


@pytest.mark.parametrize(
    ("speed_mm_s", "status"), [(0.05, "too-few-periods"), (0.15, "too-few-periods"), (1e5, "aliased")]
)
def test_a_window_in_which_no_permitted_period_can_be_seen_says_so(
    speed_mm_s: float, status: TextureStatus
) -> None:
    array, block = unknown_places(16), ridges(6, {3.0: 1.0})
    motion = WaveMotion(speed_mm_s)
    window = FitWindow(block.volts, block.time_s, np.zeros(16), channel_layout(array), motion, JointParams())
    assert fit_line(window) == Refusal(status)


@given(cuts=splits(800))
@settings(max_examples=5, deadline=None)
def test_scans_of_unknown_speed_are_no_part_of_a_window_of_known_speed(cuts: list[int]) -> None:
    block = ridges(9, {4.0: 1.0}, seconds=800 / RATE_HZ)
    estimator = JointTexture(unknown_places(16), fit=fit_wave_or_line, looks_back_s=LOOKS_BACK_S)
    estimator.set_speed(8.0, round(6.8 * RATE_HZ))
    onset = dataclasses.replace(slip_at(5.0, 0.0), detected_s=7.5)
    events: list[Event] = []
    for part in pieces(block, cuts):
        is_detected = part.time_s[0] <= onset.detected_s <= part.time_s[-1]
        events += estimator.process(part, [onset] if is_detected else [])
    found = textures(events)
    assert {event.speed_mm_s for event in found} == {8.0}
    lines = [event for event in found if event.status == "period-only"]
    assert lines
    assert all(event.period_max_mm == pytest.approx(2.0, rel=0.05) for event in lines)


def test_nothing_is_answered_over_a_flat_surface() -> None:
    statuses = set()
    for seed in range(10):
        statuses |= {e.status for e in answers(unknown_places(16), [ridges(2000 + seed, {})], speed_mm_s=6.0)}
    assert "period-only" not in statuses
    assert "ok" not in statuses


def test_sliding_goes_on_after_a_gap_and_is_cut_to_its_interval() -> None:
    block = ridges(8, {4.0: 1.0}, seconds=9.0)
    array = unknown_places(16)
    params = DetectParams.model_validate({"texture": {"speed_mm_s": 10.0}})
    suite = build_suite(array, params, sliding=KnownSliding(1.0, 5.0), topics=("texture",))
    inside = [e.time_s for e in suite.process(block)]
    assert inside
    assert 3.4 < inside[0] < 3.9  # the second fit of 86 scans or more
    assert inside[-1] < 5.0
    gap = Gap(40, "missing", 160)
    suite = build_suite(array, params, sliding=KnownSliding(), topics=("texture",))
    times = [e.time_s for item in (block[:120], gap, block[160:]) for e in suite.process(item)]
    assert any(time_s < 3.4 for time_s in times)
    assert not any(3.4 < time_s < 160 / RATE_HZ + 1.3 for time_s in times)
    assert times[-1] > 8.5


def test_dead_channels_are_left_out() -> None:
    block = ridges(9, {4.0: 1.0})
    readings = block.volts.copy()
    readings[:, 3] = np.nan
    readings[::30, 5] = np.nan
    readings[:, 7] = 2000.0
    found = answers(unknown_places(16), [regular_block(readings, RATE_HZ)], speed_mm_s=10.0)
    assert found[-1].period_mm == pytest.approx(2.5, rel=0.005)


@pytest.mark.parametrize("seed", range(4))
def test_uneven_ridges_on_a_rough_surface_are_a_line_and_the_surface_alone_is_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.arange(200) / RATE_HZ
    shared = coloured(rng, 200, 3, 1.5) @ rng.standard_normal((3, 16))
    rough = 20 * shared + rng.standard_normal((200, 16))
    heights = 1 + 0.25 * rng.standard_normal((40, 16))
    way = 3.0 * time_s[:, np.newaxis] + rng.uniform(0, 1, 16)
    ridge = heights[np.floor(way).astype(int), np.arange(16)] * np.cos(2 * np.pi * way)
    assert spectral_lines(swing_spectrum(rough), time_s, (0.0, 16.0)) == []
    (line, *_) = spectral_lines(swing_spectrum(rough + 60 * ridge), time_s, (0.0, 16.0))
    assert abs(line.frequency_hz - 3.0) < 3 * line.frequency_sd_hz


def hum(frequency_hz: float, amplitude: float, n: int) -> np.ndarray:
    """Swing of the load as a whole, in standard deviations of the noise: (n, 1)."""
    return np.asarray(amplitude * np.cos(2 * np.pi * frequency_hz * np.arange(n) / RATE_HZ)[:, np.newaxis])


def test_what_swings_all_channels_at_once_may_be_a_machine() -> None:
    alone, beside = ridges(11, {}, seconds=9.0), ridges(12, {4.0: 1.0})
    gains = np.random.default_rng(13).uniform(0.5, 1.5, 16)
    shaken = regular_block(alone.volts + 20 * gains * hum(4.9, 1.0, len(alone)), RATE_HZ)
    found = answers(unknown_places(16), [shaken], speed_mm_s=10.0)
    assert {event.status for event in found} == {"machine"}
    assert found[-1].frequency_hz == pytest.approx(4.9, abs=0.1)
    assert found[-1].period_mm == 0.0
    weaker = regular_block(beside.volts + 20 * gains * hum(9.0, 0.3, len(beside)), RATE_HZ)
    last = answers(unknown_places(16), [weaker], speed_mm_s=10.0)[-1]
    assert last.status == "period-only"
    assert last.period_mm == pytest.approx(2.5, rel=0.01)
    one = answers(unknown_places(1), [ridges(14, {4.0: 1.0}, channels=1)], speed_mm_s=10.0)
    assert one[-1].status == "period-only"  # a single channel cannot tell


def test_a_line_that_travels_beside_a_stronger_machine_is_answered_but_not_its_harmonics() -> None:
    gains = np.random.default_rng(13).uniform(0.5, 1.5, 16)
    beside = ridges(12, {4.0: 1.0}, seconds=9.0)
    shaken = regular_block(beside.volts + 20 * gains * hum(7.1, 2.0, len(beside)), RATE_HZ)
    last = answers(unknown_places(16), [shaken], speed_mm_s=10.0)[-1]
    assert last.status == "period-only"
    assert last.period_mm == pytest.approx(2.5, rel=0.01)
    twice = ridges(12, {14.2: 1.0}, seconds=9.0)  # where the second harmonic of the machine would be
    shaken = regular_block(twice.volts + 20 * gains * hum(7.1, 2.0, len(twice)), RATE_HZ)
    found = answers(unknown_places(16), [shaken], speed_mm_s=10.0)
    assert {event.status for event in found} == {"machine"}


@pytest.mark.parametrize(
    ("line_hz", "amplitude", "is_machine"), [(14.2, 1.0, True), (11.0, 1.0, False), (14.2, 0.1, False)]
)
def test_a_harmonic_of_a_machine_may_be_stronger_than_its_first_line(
    line_hz: float, amplitude: float, is_machine: bool
) -> None:
    gains = np.random.default_rng(13).uniform(0.5, 1.5, 16)
    travels = ridges(12, {line_hz: 1.0}, seconds=9.0)  # the stronger swing
    shaken = regular_block(travels.volts + 20 * gains * hum(7.1, amplitude, len(travels)), RATE_HZ)
    last = answers(unknown_places(16), [shaken], speed_mm_s=20.0)[-1]
    assert last.status == ("machine" if is_machine else "period-only")
    assert last.frequency_hz == pytest.approx(7.1 if is_machine else line_hz, abs=0.1)


def test_a_weak_ripple_beside_a_strong_one_that_is_too_slow_is_no_answer() -> None:
    lines = {0.25: 60.0, 4.0: 0.5}  # two periods of the first in 8 s, and it changes the readings more
    found = answers(unknown_places(16), [ridges(15, lines, seconds=9.0)], speed_mm_s=5.0, max_period_mm=30.0)
    assert {event.status for event in found} == {"too-few-periods"}


def test_a_log_of_a_slow_slide_is_answered_from_a_longer_window() -> None:
    block = ridges(16, {0.3: 4.0}, seconds=31.0, slope=0.5)
    last = answers(unknown_places(16), [block], speed_mm_s=6.0, max_period_mm=30.0)[-1]
    assert last.status == "period-only"
    assert last.period_mm == pytest.approx(20.0, rel=0.02)
    assert last.window_s > 15.0


def test_a_line_is_reported_where_the_window_before_has_it_too() -> None:
    block = ridges(17, {4.0: 1.0}, seconds=4.0)
    params = JointParams(speed_mm_s=10.0, settle_s=0.0, answer_after_s=0.0)
    fits = iter([3.0, 9.0, 9.01, 20.0, 9.01, 0.0, 9.02, -1.0, 9.03])

    def fit(_window: FitWindow) -> Outcome:
        if (at := next(fits, 0.0)) <= 0.0:
            return Refusal("low-snr" if at == 0.0 else "too-few-periods")  # the latter says nothing of a line
        period = Candidate(period_mm=10 / at, angle_deg=0.0, weight=1.0)
        return PeriodOnly(frequency_hz=at, snr_db=0.0, gratings=(period,))

    texture = JointTexture(unknown_places(16), params, fit=fit)
    suite = Suite(None, texture, sliding=KnownSliding())
    told = [event.frequency_hz for event in suite.process(block) if isinstance(event, TextureEvent)]
    assert [at for at in told if at] == [9.01, 9.03]
