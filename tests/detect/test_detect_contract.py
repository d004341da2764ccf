"""Promises of `tactiled.detect.base`, for the detectors of each setting on several arrays and rates."""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import pytest
from contact_gate import ContactGate
from hypothesis import given, settings
from hypothesis import strategies as st
from touches import Touch, assert_sound, pieces, run, splits

from tactiled.array import Array, ArrayFile, Grid, TaxelChannel, build, load_array
from tactiled.detect.base import Detector
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectParams, Suite, build_suite
from tactiled.events.types import Event
from tactiled.samples.block import Gap, ScanBlock, regular_block
from tactiled.wang2019.grooves import GrooveLimits
from tactiled.wang2019.slip import WaveletSlip
from tactiled.wang2019.texture import PaperTexture

SPEED_MM_S = 4.0


def model(array: Array) -> Suite:
    """The detectors that the settings of the core share."""
    return build_suite(array, DetectParams(texture=JointParams(speed_mm_s=SPEED_MM_S, hop_s=1.0)))


def published(array: Array) -> Suite:
    """The published methods, with windows that the slide fills."""
    return Suite(WaveletSlip(array), PaperTexture(array, SPEED_MM_S, limits=GrooveLimits(window_s=2.0)))


# The contact gate is a part of slip detectors; no setting runs it alone.
DETECTORS: dict[str, Callable[[Array], Detector]] = {
    "contact": ContactGate,
    "balanced": model,
    "wang2019": published,
}
ONE_TAXEL = build(
    ArrayFile(
        name="one",
        grids=[Grid(x_mm=[0.0], y_mm=[0.0])],
        taxel_channels=[
            TaxelChannel(name=f"R{k}", kind="side", azimuth_deg=180.0 + 90 * k) for k in range(4)
        ],
    )
)
SLOW = {"balanced": 3}  # examples of a hypothesis test
RATES_HZ = {"wang2019-3x3": 100.0, "normal-4x4": 35.7, "xyz-two-pads-4x4": 60.0, "one": 100.0}
ARRAYS = {name: ONE_TAXEL if name == "one" else load_array(name) for name in RATES_HZ}
GAP = Gap(50, "missing", 5000)  # too long for the bridge
BEGUN_ANEW = Gap(5, "restart", 5000)

every_detector = pytest.mark.parametrize("name", DETECTORS)
every_array = pytest.mark.parametrize("array", ARRAYS.values(), ids=ARRAYS)


def sliding(array: Array, rate_hz: float) -> ScanBlock:
    """Return a slide over grooves with missing readings and late scans."""
    touch = Touch(
        grooves=(2.0, 20.0), speed_mm_s=SPEED_MM_S, ripple=0.1, slide_s=2.5, stop_s=6.0, lift_s=7.0, end_s=7.5
    )
    block = touch.block(array, rate_hz, np.linspace(0, 0.5 / rate_hz, array.n_channels))
    rng = np.random.default_rng(5)
    volts = block.volts.copy()
    volts[rng.random(volts.shape) < 2e-4] = np.nan
    late = np.zeros(len(block), dtype=np.bool_)
    late[-20:] = True
    valid = (rng.random(volts.shape) > 2e-4) & np.isfinite(volts)
    return dataclasses.replace(block, volts=volts, valid=valid, late=late)


@functools.cache
def whole(name: str, array_name: str) -> tuple[ScanBlock, list[Event]]:
    """The slide on an array, and the events of a new detector that sees nothing else."""
    array = ARRAYS[array_name]
    block = sliding(array, RATES_HZ[array_name])
    return block, DETECTORS[name](array).process(block)


@every_detector
@every_array
def test_a_slide_gives_events(name: str, array: Array) -> None:
    _, events = whole(name, array.name)
    assert len(events) >= 3
    assert_sound(events)


@every_detector
@every_array
def test_any_chunking_gives_the_same_events(name: str, array: Array) -> None:
    block, events = whole(name, array.name)

    @given(splits(len(block)))
    @settings(max_examples=SLOW.get(name, 8), deadline=None)
    def check_chunking(cuts: list[int]) -> None:
        assert run(DETECTORS[name](array), pieces(block, cuts)) == events

    check_chunking()


@every_detector
@every_array
def test_reset_equals_new(name: str, array: Array) -> None:
    block, events = whole(name, array.name)
    detector = DETECTORS[name](array)
    detector.process(block[: len(block) * 2 // 3])
    detector.reset()
    assert detector.process(block) == events


@every_detector
@every_array
def test_a_gap_ends_events_and_a_board_that_begins_anew_equals_reset(name: str, array: Array) -> None:
    block, events = whole(name, array.name)
    for cut in (1, len(block) * 2 // 3):
        detector = DETECTORS[name](array)
        before = detector.process(block[:cut])
        at_gap = detector.process(GAP)
        assert not any(getattr(event, "valid", False) for event in at_gap)
        # A contact or slip that has begun is ended by an event, so that no subscriber waits for its end.
        for topic, rest_state in (("contact", "none"), ("slip", "end")):
            states = [getattr(e, "state", "") for e in [*before, *at_gap] if e.topic == topic]
            assert states == [] or states[-1] == rest_state
        assert detector.process(GAP) == []
        assert detector.process(BEGUN_ANEW) == []
        assert detector.process(block) == events


@every_detector
@every_array
@pytest.mark.parametrize("value", [0.0, 1.2, 3.0, -5.0, 1e308, np.nan, np.inf, -np.inf])
def test_constant_readings_give_no_slip_and_finite_events(name: str, array: Array, value: float) -> None:
    block = regular_block(np.full((700, array.n_channels), value), RATES_HZ[array.name])
    events = DETECTORS[name](array).process(block)
    assert_sound(events)
    assert not any(event.topic in ("slip", "texture") for event in events)


@every_detector
@every_array
def test_steps_noise_and_dropouts_of_any_size_give_finite_events(name: str, array: Array) -> None:
    make, rate_hz = DETECTORS[name], RATES_HZ[array.name]

    @given(st.integers(0, 10**6), st.sampled_from([1e-6, 1e-3, 0.1, 10.0, 1e300]), st.floats(0, 1))
    @settings(max_examples=SLOW.get(name, 15), deadline=None)
    def check_finite(seed: int, size: float, dropped: float) -> None:
        rng = np.random.default_rng(seed)
        volts = 1.0 + size * np.sign(rng.normal(size=(400, array.n_channels))).cumsum(axis=0)
        volts[rng.random(volts.shape) < dropped / 5] = np.nan
        assert_sound(
            make(array).process(regular_block(volts, rate_hz, valid=rng.random(volts.shape) > dropped / 5))
        )

    check_finite()
