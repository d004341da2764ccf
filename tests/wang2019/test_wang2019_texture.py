"""When the published procedure samples, what it takes, and when it refuses."""

import dataclasses

import numpy as np
import pytest
from touches import Touch, pieces, published, run, slips, textures

from tactiled.array import Array, ArrayFile, Channel, TaxelPlace, build, load_array
from tactiled.events.types import SlipEvent, TextureEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.wang2019.grooves import GrooveLimits
from tactiled.wang2019.slip import WaveletSlip
from tactiled.wang2019.texture import PaperTexture

WANG = load_array("wang2019-3x3")
KNOWN_SPEED = 1.0
SLIDE = Touch(grooves=(1.2, 20.0), stop_s=40.0, lift_s=42.0, end_s=43.0)


def detect(touch: Touch, speed_mm_s: float = KNOWN_SPEED, array: Array = WANG) -> list[TextureEvent]:
    return textures(published(array, speed_mm_s).process(touch.block(array)))


def slip_at(block: ScanBlock, scan: int, state: str = "onset") -> SlipEvent:
    """A slip event along +x that was detected at a scan."""
    assert state in ("onset", "end")
    return SlipEvent(
        time_s=float(block.time_s[scan]),
        state="onset" if state == "onset" else "end",
        kind="gross",
        onset_s=float(block.time_s[scan]),
        onset_sd_s=0.01,
        direction_deg=0.0,
        direction_sd_deg=0.5,
        confidence=1.0,
        taxels=(0,),
        detector="test",
        statistic=1.0,
        threshold=0.002,
        valid=True,
        detected_s=float(block.time_s[scan]),
    )


def test_answers_every_ten_seconds_while_slip_lasts() -> None:
    block = SLIDE.block(WANG)
    events = published(WANG, KNOWN_SPEED).process(block)
    onset = slips(events)[0]
    found = textures(events)
    first = onset.detected_s + 1.0 + 10.0
    assert [event.time_s for event in found] == pytest.approx([first + 10 * k - 0.01 for k in range(3)])
    assert {event.status for event in found} <= {"ok", "ambiguous"}
    for event in found:
        assert event.estimator == "wang2019"
        assert (event.speed_mm_s, event.speed_source, event.window_s) == (1.0, "given", 10.0)


@pytest.mark.parametrize("direction_deg", [0.0, 180.0])
@pytest.mark.parametrize("angle_deg", [-40.0, -10.0, 0.0, 25.0, 55.0])
def test_period_and_angle_whichever_way_it_slides(direction_deg: float, angle_deg: float) -> None:
    good = []
    for seed in range(2):
        touch = dataclasses.replace(SLIDE, grooves=(1.2, angle_deg), direction_deg=direction_deg, seed=seed)
        good += [event for event in detect(touch) if event.status == "ok"]
    assert good
    for event in good:  # leakage is at most four of its sigmas: see `grooves`
        assert abs(event.angle_deg - angle_deg) <= 4 * event.angle_sd_deg
        assert abs(event.period_mm - 1.2) <= 4 * event.period_sd_mm


def test_scan_skew_of_the_channels_is_taken_off() -> None:
    touch = dataclasses.replace(SLIDE, grooves=(3.0, 10.0), speed_mm_s=10.0)
    offsets_s = 250e-6 * np.arange(36.0)  # 3 ms from row to row
    block = touch.block(WANG, 1000.0, offsets_s)
    texture = PaperTexture(WANG, 10.0, limits=GrooveLimits(agreement_mm=0.05))
    events = textures(texture.process(block, WaveletSlip(WANG).process(block)))
    assert events[0].status == "ok"
    assert abs(events[0].angle_deg - 10.0) <= 3 * events[0].angle_sd_deg


def test_a_flat_plate_has_no_grooves() -> None:
    statuses = [event.status for event in detect(dataclasses.replace(SLIDE, grooves=None))]
    assert statuses == ["low-snr"] * 3


def test_no_slip_no_texture() -> None:
    assert detect(dataclasses.replace(SLIDE, slide_s=99.0, stop_s=100.0)) == []


def test_a_slip_too_short_for_a_window_is_no_slip() -> None:
    (only,) = detect(dataclasses.replace(SLIDE, stop_s=9.0, lift_s=12.0))
    assert only.status == "no-slip"
    assert 0 < only.window_s < 10.0
    assert (only.period_mm, only.frequency_hz) == (0.0, 0.0)


def test_without_a_speed_it_cannot_answer() -> None:
    found = detect(SLIDE, 0.0)
    assert [event.status for event in found] == ["no-slip"] * 3
    assert {(event.speed_mm_s, event.speed_source) for event in found} == {(0.0, "none")}


def test_a_speed_set_later_starts_a_window_at_its_scan() -> None:
    block = SLIDE.block(WANG)
    for step in (len(block), 1, 700):
        detector = published(WANG)
        assert detector.texture is not None
        detector.texture.set_speed(1.0, from_index=int(block.index[2000]))
        found = textures(run(detector, pieces(block, range(step, len(block), step))))
        assert [event.time_s for event in found if event.speed_source == "given"] == pytest.approx(
            [float(block.time_s[2999]), float(block.time_s[3999])]
        )


def test_a_window_that_ends_with_a_late_scan_is_stale_and_no_other() -> None:
    """An old answer must not look fresh; one scan that came late ten seconds ago is good data."""
    block = SLIDE.block(WANG)

    def statuses(late_scan: int) -> list[bool]:
        late = np.zeros(len(block), dtype=np.bool_)
        late[late_scan] = True
        detector = published(WANG, KNOWN_SPEED)
        return [
            e.status == "stale" for e in textures(detector.process(dataclasses.replace(block, late=late)))
        ]

    ends = textures(published(WANG, KNOWN_SPEED).process(block))
    last = int(np.searchsorted(block.time_s, ends[0].time_s))
    assert statuses(last) == [True, False, False]
    assert statuses(last - 500) == [False, False, False]


def test_bad_channels_are_passed_over_until_none_is_left() -> None:
    block = SLIDE.block(WANG)
    slip = [slip_at(block, 410)]
    for spoilt, is_saturated in (
        ([0], False),
        ([0, 13, 26], False),
        ([0, 1, 14, 27], True),
        (range(36), True),
    ):
        volts = block.volts.copy()
        volts[600:700, list(spoilt)] = np.nan
        bad = dataclasses.replace(block, volts=volts, valid=np.isfinite(volts))
        found = textures(PaperTexture(WANG, KNOWN_SPEED).process(bad, slip))
        assert (found[0].status == "saturated") == is_saturated
        assert found[1].status != "saturated"


def test_a_gap_discards_the_window_and_waits_for_slip_anew() -> None:
    block = SLIDE.block(WANG)
    estimator = PaperTexture(WANG, KNOWN_SPEED)
    assert estimator.process(block[:1400], [slip_at(block, 410)]) == []
    assert estimator.process(Gap(2, "missing", 1409)) == []
    assert estimator.process(block[1402:]) == []


def test_onset_and_end_within_one_block() -> None:
    block = SLIDE.block(WANG)
    changes = [
        slip_at(block, 500),
        slip_at(block, 1700, "end"),
        slip_at(block, 2000),
        slip_at(block, 2500, "end"),
    ]
    found = textures(PaperTexture(WANG, KNOWN_SPEED).process(block, changes))
    assert [event.time_s for event in found] == pytest.approx(block.time_s[[1599, 2500]].tolist())
    assert found[1].status == "no-slip"


def test_an_array_without_a_column_cannot_tell_an_angle() -> None:
    lonely = build(
        ArrayFile(
            name="row",
            taxels=[TaxelPlace(x_mm=0.0, y_mm=0.0), TaxelPlace(x_mm=3.5, y_mm=0.0)],
            channels=[
                Channel(name=f"R{k}", taxel=taxel, kind="side", azimuth_deg=180.0 + 90 * k)
                for taxel in range(2)
                for k in range(4)
            ],
        )
    )
    assert {event.status for event in detect(SLIDE, array=lonely)} == {"ambiguous"}
