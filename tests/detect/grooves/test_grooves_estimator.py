"""The joint estimator online: the contract of every detector, when it answers, and what it refuses."""

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pytest
from gratings import Grating, Slide, grid
from hypothesis import given, settings
from slips import slip_at
from touches import Touch, pieces, splits, textures

from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.grooves.estimator import JointTexture
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.outcome import GrooveAnswer, NewPattern, Outcome, Refusal
from tactiled.detect.grooves.params import PRESETS, JointParams
from tactiled.detect.grooves.window import FitWindow
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock, regular_block
from tactiled.wang2019.slip import WaveletSlip

ARRAY = load_array("wang2019-3x3")
SKEW_S = np.linspace(0, 0.007, 36)
PERIOD_MM, ANGLE_DEG, SPEED_MM_S = 1.2, 20.0, 2.0
TOUCH = Touch(grooves=(PERIOD_MM, ANGLE_DEG), speed_mm_s=SPEED_MM_S, slide_s=3.0, stop_s=9.0)


class Slid:
    """Slip and joint texture as one detector."""

    def __init__(self, params: JointParams, array: Array = ARRAY) -> None:
        self.slip = WaveletSlip(array)
        self.texture = JointTexture(array, params)

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        events = self.slip.process(item)
        return [*events, *self.texture.process(item, events)]

    def reset(self) -> None:
        self.slip.reset()
        self.texture.reset()


def answers(params: JointParams, block: ScanBlock) -> list[TextureEvent]:
    return textures(Slid(params).process(block))


@pytest.mark.parametrize("speed_mm_s", [0.0, SPEED_MM_S])
def test_any_chunking_gives_the_same_bits(speed_mm_s: float) -> None:
    block = TOUCH.block(ARRAY, 100.0, SKEW_S)
    params = JointParams(preset="quick", speed_mm_s=speed_mm_s, hop_s=1.0)
    whole = answers(params, block)
    assert any(e.status == "ok" for e in whole)

    @given(splits(len(block)))
    @settings(max_examples=6, deadline=None)
    def same(cuts: list[int]) -> None:
        detector = Slid(params)
        assert textures([e for part in pieces(block, cuts) for e in detector.process(part)]) == whole

    same()


def stub_answer(window: FitWindow) -> GrooveAnswer:
    """An answer that any preset takes, and that says which window it is of."""
    return GrooveAnswer(
        frequency_hz=99.0, snr_db=0.0, period_mm=1.0, angle_deg=0.0, speed_mm_s=0.0,
        covariance=np.zeros((3, 3)), uses_given_speed=False, stray_rad=float(window.time_s[-1]),
    )  # fmt: skip


@given(cuts=splits(1000))
@settings(max_examples=10, deadline=None)
def test_fits_that_are_due_between_two_slides_are_reported_as_live(cuts: list[int]) -> None:
    block = regular_block(np.zeros((1000, 36)), 100.0)
    scans = (100, 405, 412, 600, 700)  # onset and end in turn
    slips = [slip_at(float(block.time_s[scan]), 0.0, 1.0) for scan in scans]
    slips[1::2] = [dataclasses.replace(slip, state="end") for slip in slips[1::2]]

    def texture(parts: list[ScanBlock]) -> list[Event]:
        detector = JointTexture(ARRAY, JointParams(hop_s=0.13), fit=stub_answer)
        detector.set_speed(1.0, 0)
        detector.set_speed(-1.0, 333)
        return [
            event
            for part in parts
            for event in detector.process(
                part, [e for e in slips if part.time_s[0] <= e.detected_s <= part.time_s[-1]]
            )
        ]

    live = texture(pieces(block, range(1, 1000)))
    assert len(textures(live)) > 20
    assert texture([block]) == live
    assert texture(pieces(block, cuts)) == live


@pytest.mark.parametrize(
    ("statuses", "reverses_at", "reported"),
    [
        (["ok", "ok", "low-snr"], 999, ["ok", "ok", "low-snr"]),  # the answer is lost, and the slip ends
        (["ok", "ok", "new-pattern"], 999, ["ok", "ok", "ambiguous"]),
        (["ok", "ok", "ok"], 61, ["ok", "ok", "ok"]),  # the window of the other direction has no fit
        (["low-snr", "low-snr", "low-snr"], 999, ["low-snr"]),
        (["low-snr", "low-snr", "low-snr"], 61, ["no-slip"]),
    ],
)
def test_the_end_of_a_slip_is_refused_once_and_only_without_an_answer_before(
    statuses: list[str], reverses_at: int, reported: list[str]
) -> None:
    outcomes = iter(statuses)

    def fit(window: FitWindow) -> Outcome:
        match next(outcomes):
            case "ok":
                return stub_answer(window)
            case "new-pattern":
                return NewPattern("ambiguous")
        return Refusal("low-snr")

    block = regular_block(np.zeros((300, 36)), 100.0)
    ended = dataclasses.replace(slip_at(float(block.time_s[65]), 0.0), state="end")
    texture = JointTexture(ARRAY, JointParams(settle_s=0.0, speed_mm_s=1.0), fit=fit)  # fits at 19, 39, 59
    texture.set_speed(-1.0, reverses_at)
    slips = [slip_at(0.0, 0.0), ended]
    assert [event.status for event in textures(texture.process(block, slips))] == reported


def test_a_late_tracked_fit_is_no_reason_to_fit_anew() -> None:
    def fitted_until_s(late_index: int) -> list[float]:
        ends_s: list[float] = []

        def fit(window: FitWindow) -> Outcome:
            ends_s.append(float(window.time_s[-1]))
            return fit_wave(window)

        texture = JointTexture(ARRAY, JointParams(settle_s=0.0, speed_mm_s=2.0, max_window_s=6.0), fit=fit)
        texture.expect_late_fit(late_index)
        events = textures(texture.process(Ride(np.full(500, 2.0)).block(), [slip_at(0.0, 0.0, 1.0)]))
        assert [e.status for e in events].count("stale") == (late_index > 0)
        return ends_s

    assert fitted_until_s(259 + 40) == fitted_until_s(0)


@pytest.mark.parametrize("speed_mm_s", [0.0, SPEED_MM_S])
def test_answers_within_three_seconds_and_holds_its_sigmas(speed_mm_s: float) -> None:
    events = answers(JointParams(preset="quick", speed_mm_s=speed_mm_s), TOUCH.block(ARRAY, 100.0, SKEW_S))
    first = next(e for e in events if e.status == "ok")
    assert first.time_s - (100.0 + TOUCH.slide_s) < 3.0
    for event in (first, *(e for e in events if e.status == "ok")):
        assert event.period_mm == pytest.approx(PERIOD_MM, abs=5 * event.period_sd_mm)
        assert event.angle_deg == pytest.approx(ANGLE_DEG, abs=5 * event.angle_sd_deg)
        assert event.period_sd_mm <= 0.02
        assert event.angle_sd_deg <= 1.0
        assert event.speed_source == ("given" if speed_mm_s else "estimated")
        assert event.speed_mm_s == pytest.approx(SPEED_MM_S, rel=0.02)


def test_reset_equals_new_and_a_gap_forgets() -> None:
    block = TOUCH.block(ARRAY, 100.0, SKEW_S)
    params = JointParams(preset="quick", speed_mm_s=SPEED_MM_S, hop_s=0.5)
    whole = answers(params, block)
    detector = Slid(params)
    detector.process(block[:700])
    detector.texture.set_speed(9.0, 5)
    detector.reset()
    assert textures(detector.process(block)) == whole
    detector.process(Gap(5, "missing", 5000))
    assert detector.texture.process(block[450:]) == []  # no slip has been reported since


def test_a_slip_too_short_to_answer_ends_with_the_reason() -> None:
    short = dataclasses.replace(TOUCH, stop_s=TOUCH.slide_s + 0.6)
    events = answers(JointParams(speed_mm_s=SPEED_MM_S), short.block(ARRAY, 100.0, SKEW_S))
    assert [e.status for e in events] in (["too-few-periods"], ["no-slip"], ["ambiguous"])


def test_a_flat_plate_is_refused_once_a_window() -> None:
    flat = dataclasses.replace(TOUCH, grooves=None, stop_s=14.0, lift_s=15.0, end_s=16.0)
    for speed_mm_s in (0.0, SPEED_MM_S):
        events = answers(JointParams(preset="quick", speed_mm_s=speed_mm_s), flat.block(ARRAY, 100.0, SKEW_S))
        assert 2 <= len(events) <= 5
        assert {e.status for e in events} <= {"low-snr", "too-few-periods"}


def test_backlog_is_stale() -> None:
    block = TOUCH.block(ARRAY, 100.0, SKEW_S)
    block = dataclasses.replace(block, late=np.ones(len(block), dtype=np.bool_))
    events = answers(JointParams(preset="quick", speed_mm_s=SPEED_MM_S), block)
    assert {e.status for e in events} == {"stale"}


def test_saturation_of_all_channels_is_reported() -> None:
    block = TOUCH.block(ARRAY, 100.0, SKEW_S)
    valid = block.valid.copy()
    slip = WaveletSlip(ARRAY).process(block)
    valid[400:] = False
    texture = JointTexture(ARRAY, JointParams(preset="quick", speed_mm_s=SPEED_MM_S))
    events = textures(texture.process(dataclasses.replace(block, valid=valid), slip))
    assert "saturated" in {e.status for e in events}
    assert all(np.isfinite(e.snr_db) for e in events)


@dataclass(frozen=True)
class Ride:
    """A block of sliding at a given speed profile, and its slip event."""

    speeds_mm_s: FloatArray
    grating: Grating = field(default=Grating())
    direction_deg: float = 0.0

    def block(self) -> ScanBlock:
        theta, a = np.radians(self.direction_deg), np.radians(self.grating.angle_deg)
        way = np.concatenate([[0.0], np.cumsum(self.speeds_mm_s[:-1])])[:, np.newaxis] / 100
        way = way + self.speeds_mm_s[:, np.newaxis] * SKEW_S
        x = ARRAY.x_mm[ARRAY.channel_taxel] + way * np.cos(theta)
        y = ARRAY.y_mm[ARRAY.channel_taxel] + way * np.sin(theta)
        phase = 2 * np.pi * (x * np.cos(a) + y * np.sin(a)) / self.grating.period_mm
        noise = 0.003 * np.random.default_rng(4).normal(size=phase.shape)
        volts = 1 + self.grating.amplitude * np.cos(phase + ARRAY.azimuth_deg) + noise
        return regular_block(volts, 100.0, channel_offset_s=SKEW_S)

    def events(
        self, params: JointParams, speeds: Iterable[tuple[int, float]] = (), direction_sd_deg: float = 1.0
    ) -> list[TextureEvent]:
        texture = JointTexture(ARRAY, params)
        for scan, speed_mm_s in speeds:
            texture.set_speed(speed_mm_s, scan)
        slip = slip_at(0.0, self.direction_deg, direction_sd_deg)
        return textures(texture.process(self.block(), [slip]))


def right(event: TextureEvent, grating: Grating) -> bool:
    by_mm = event.period_mm - grating.period_mm
    by_deg = (event.angle_deg - grating.angle_deg + 90) % 180 - 90
    return abs(by_mm) < 5 * event.period_sd_mm and abs(by_deg) < 5 * event.angle_sd_deg


def test_presets_trade_time_for_sigma() -> None:
    ride = Ride(np.full(500, 1.0), Grating(1.2, 30.0))
    firsts = []
    for preset in PRESETS:
        events = ride.events(JointParams(preset=preset, speed_mm_s=1.0, direction_deg=0.0))
        firsts.append(next(e for e in events if e.status == "ok"))
    assert all(right(e, ride.grating) for e in firsts)
    assert [e.time_s for e in firsts] == sorted({e.time_s for e in firsts})
    assert firsts[0].angle_sd_deg > firsts[1].angle_sd_deg > firsts[2].angle_sd_deg
    told = JointParams(preset="fine", max_window_s=3.0).criteria
    assert told == PRESETS["fine"]._replace(max_window_s=3.0)


def test_a_streamed_speed_profile_does_not_smear() -> None:
    speeds = 1.0 + 0.8 * np.sin(np.arange(800) / 60)
    ride = Ride(speeds)
    events = ride.events(JointParams(preset="quick"), enumerate(speeds.tolist()))
    fine = [e for e in events if e.status == "ok"]
    assert len(fine) > 0.9 * len(events) > 10
    assert all(right(e, ride.grating) for e in fine)


def test_a_reversed_speed_begins_a_new_window_and_reverses_the_direction() -> None:
    speeds = np.where(np.arange(1000) < 500, 2.0, -2.0)
    ride = Ride(speeds, direction_deg=25.0)
    for direction_deg in (None, 25.0):
        params = JointParams(preset="quick", direction_deg=direction_deg)
        events = ride.events(params, [(0, 2.0), (500, -2.0)])
        assert all(right(e, ride.grating) for e in events if e.status == "ok")
        assert any(e.status == "ok" and e.time_s > 8.0 for e in events)
        assert max(e.window_s for e in events if 5.0 < e.time_s < 7.0) <= 2.0


def test_a_stop_in_mid_slip_is_no_wrong_answer() -> None:
    speeds = np.concatenate([np.full(400, 2.0), np.zeros(400)])
    ride = Ride(speeds)
    events = ride.events(JointParams(preset="quick"))
    assert all(right(e, ride.grating) for e in events if e.status == "ok" and e.time_s < 4.0)
    assert all(e.status != "ok" for e in events if e.time_s > 7.5)  # the window holds the stop alone


def test_without_a_direction_period_and_angle_are_found_and_no_speed() -> None:
    ride = Ride(np.full(400, 2.0))
    events = ride.events(JointParams(preset="quick"), direction_sd_deg=180.0)
    fine = [e for e in events if e.status == "ok"]
    assert len(fine) > 3
    assert all(right(e, ride.grating) and e.speed_source == "none" for e in fine)


def test_two_gratings_are_refused_as_such() -> None:
    strong, weak = Grating(1.5, 30.0, 0.05), Grating(0.8, -40.0, 0.02)
    ride, other = Ride(np.full(600, 2.0), strong), Ride(np.full(600, 2.0), weak)
    block = ride.block()
    block = dataclasses.replace(block, volts=block.volts + other.block().volts - 1)
    texture = JointTexture(ARRAY, JointParams(preset="quick", speed_mm_s=2.0))
    events = textures(texture.process(block, [slip_at(0.0, 0.0, 1.0)]))
    assert all(right(event, strong) for event in events if event.status == "ok")
    assert events[-1].status == "several-gratings"
    assert (events[-1].period_mm, events[-1].candidates) == (0.0, ())


def test_a_slide_that_never_ends_does_not_drift() -> None:
    """Windows of the same scans, one after the other, give one answer."""
    ride = Ride(np.full(600, 2.0), Grating(1.0, 0.0))  # 2 periods a second: 12 periods in 600 scans
    block = ride.block()
    texture = JointTexture(ARRAY, JointParams(speed_mm_s=2.0, max_window_s=3.0, hop_s=6.0))
    answers: list[TextureEvent] = []
    for turn in range(80):
        index = block.index + 600 * turn
        again = dataclasses.replace(block, index=index, time_s=block.time_s + 6.0 * turn)
        answers += textures(texture.process(again, [slip_at(0.0, 0.0, 1.0)] if turn == 0 else []))
    settled = [(e.period_mm, e.angle_deg) for e in answers[2:]]
    assert len(settled) > 70
    assert np.ptp(settled, axis=0) == pytest.approx([0.0, 0.0], abs=1e-7)


def test_ten_million_scans_of_one_slide_do_not_change_the_answer() -> None:
    """All scans pass through window and hops; late ones (a backlog) are not fitted, to save time."""
    column, n = grid([0.0], [0.0, 3.5, 7.3]), 20_000
    grating = Grating(1.0, 20.0)
    # A whole number of periods of 10 s, so that scans may be repeated.
    speed_mm_s = 2.0 / np.cos(np.radians(20.0))
    slide = Slide((grating,), speed_mm_s=speed_mm_s, duration_s=n / 100)
    block = regular_block(slide.volts(column), 100.0)
    late = np.ones(n, dtype=np.bool_)
    params = JointParams(speed_mm_s=speed_mm_s, max_window_s=3.0, hop_s=10.0, settle_s=0.0, answer_after_s=0)
    texture, fresh = JointTexture(column, params), JointTexture(column, params)
    slip = slip_at(0.0, 0.0, 1.0)
    n_events = 0
    for turn in range(500):
        again = dataclasses.replace(block, index=block.index + n * turn, late=late)
        n_events += len(texture.process(again, [slip] if turn == 0 else []))
    assert n_events == 10_000_000 // 1000
    last = dataclasses.replace(block, index=block.index + 10_000_000)[:1000]
    (after,) = textures(texture.process(last))
    fresh.process(dataclasses.replace(block, late=late), [slip])
    (before,) = textures(fresh.process(last))
    assert after == before
    assert after.status == "ok"
    assert after.period_mm == pytest.approx(1.0, abs=5 * after.period_sd_mm)
