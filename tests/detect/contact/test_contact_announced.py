"""Motion that a controller announces: which acceleration a scan has, whatever the calls."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.array import Array, FloatArray, load_array
from tactiled.detect.contact.announced import HOLD_S, AnnouncedMotion, course_of
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.suite import DetectParams, Suite
from tactiled.detect.tuning import TunedSuite
from tactiled.errors import DataError
from tactiled.samples.block import Gap, ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
RATE_HZ = 100.0
instants = st.integers(0, 64).map(lambda n: n / 64)  # sums of these are exact
courses = st.lists(st.tuples(instants, st.floats(-1000, 1000)), min_size=1, max_size=6).map(
    lambda course: sorted(course, key=lambda value: value[0])
)


def announce(to: AnnouncedMotion | GripDetector, *course: tuple[float, float]) -> None:
    motion = to if isinstance(to, AnnouncedMotion) else to.motion
    time_s, acceleration_m_s2 = np.array(course, dtype=np.float64).T
    motion.announce(time_s, acceleration_m_s2)


def same(one: float, other: float) -> bool:
    return one == other or (math.isnan(one) and math.isnan(other))


@given(announced=st.lists(courses, max_size=5), asked_s=instants)
def test_the_newest_value_before_an_instant_holds_for_a_tenth_of_a_second(
    announced: list[list[tuple[float, float]]], asked_s: float
) -> None:
    motion, kept = AnnouncedMotion(), list[tuple[float, float]]()
    for course in announced:
        announce(motion, *course)
        kept = [value for value in kept if value[0] < course[0][0]] + course
    expected = math.nan
    for time_s, acceleration_m_s2 in kept:
        if time_s <= asked_s:
            expected = acceleration_m_s2 if asked_s - time_s <= HOLD_S else math.nan
    assert same(motion.at(asked_s), expected)


def test_memory_is_bounded_and_holds_two_seconds_at_1000_hz() -> None:
    motion = AnnouncedMotion()
    for k in range(100):
        announce(motion, *((k + i / 256, k) for i in range(256)))
    assert motion.at(99.0) == 99.0
    assert motion.at(92.0) == 92.0  # 2,048 values before
    assert math.isnan(motion.at(91.5))


def scans(n: int, start_s: float = 0.0, rate_hz: float = RATE_HZ) -> ScanBlock:
    volts: FloatArray = 1e-4 * np.random.default_rng(0).standard_normal((n, 36))
    return regular_block(volts, rate_hz, start_s=start_s, index=round(start_s * rate_hz))


def accelerations(detector: GripDetector, block: ScanBlock, chunk: int) -> list[float]:
    found = []
    for first in range(0, len(block), chunk):
        for _ in detector.scans(block[first : first + chunk]):
            found.append(detector.acceleration_m_s2)
    return found


@pytest.mark.parametrize("chunk", [1, 7, 60])
def test_a_scan_has_the_acceleration_of_its_instant_in_any_chunks(chunk: int) -> None:
    detector = GripDetector(ARRAY)
    announce(detector, (0.095, 9.81), (0.105, 12.0), (0.195, 11.0))
    found = accelerations(detector, scans(60), chunk)
    nothing = [math.nan]
    expected = nothing * 10 + [9.81] + [12.0] * 9 + [11.0] * 10 + nothing * 30
    assert all(map(same, found, expected))


def test_a_value_has_no_effect_on_scans_before_it_came() -> None:
    detector = GripDetector(ARRAY)
    block = scans(20)
    assert all(map(math.isnan, accelerations(detector, block[:10], 10)))
    announce(detector, (0.05, 12.0))
    found = accelerations(detector, block[10:], 10)
    assert found[:5] == [12.0] * 5
    assert all(map(math.isnan, found[6:]))


@pytest.mark.parametrize("cause", ["missing", "restart"])
def test_what_was_announced_survives_gaps_and_another_rate(cause: Any) -> None:
    detector = GripDetector(ARRAY)
    detector.process(scans(10))
    announce(detector, (0.19, 12.0), (0.29, 13.0))
    detector.process(Gap(10, cause, 20))
    detector.process(scans(1, start_s=0.2))
    assert detector.acceleration_m_s2 == 12.0
    detector.process(scans(1, start_s=0.3, rate_hz=200.0))
    assert detector.acceleration_m_s2 == 13.0
    detector.reset()
    assert math.isnan(detector.acceleration_m_s2)
    detector.process(scans(1, start_s=0.3))
    assert math.isnan(detector.acceleration_m_s2)


def test_new_detectors_are_given_what_was_announced() -> None:
    built: list[GripDetector] = []

    def build(array: Array, _params: DetectParams) -> Suite:
        built.append(GripDetector(array))
        return Suite(built[-1], None)

    suite = TunedSuite(ARRAY, DetectParams(), build)
    assert suite.announce_motion(np.array([0.0, 0.05]), np.array([9.81, 12.0])) == ""
    suite.process(scans(2))
    assert built[-1].acceleration_m_s2 == 9.81
    assert suite.set_thresholds({"grip.incipient_p": 0.5})[0] == ""
    suite.process(scans(1, start_s=0.1))
    assert (len(built), built[-1].acceleration_m_s2) == (2, 12.0)
    assert suite.acceleration_m_s2(0.06) == 12.0
    suite.reset()
    assert math.isnan(suite.acceleration_m_s2(0.06))


@pytest.mark.parametrize(
    ("array", "setting"),
    [("normal-4x4", "balanced"), ("wang2019-3x3", "wang2019")],
    ids=["no shear", "paper"],
)
def test_detectors_that_take_no_motion_refuse_it(array: str, setting: str) -> None:
    params = DetectParams.model_validate({"setting": setting})
    suite = TunedSuite(load_array(array), params)
    assert "takes friction or motion" in suite.announce_motion(np.array([0.0]), np.array([9.81]))
    assert math.isnan(suite.acceleration_m_s2(0.0))


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"time_s": [1.0]},
        {"time_s": [], "acceleration_m_s2": []},
        {"time_s": 1.0, "acceleration_m_s2": 9.81},
        {"time_s": [1.0, 2.0], "acceleration_m_s2": [9.81]},
        {"time_s": [2.0, 1.0], "acceleration_m_s2": [9.81, 9.81]},
        {"time_s": [1.0], "acceleration_m_s2": [math.inf]},
        {"time_s": [1.0], "acceleration_m_s2": ["much"]},
        {"time_s": [1.0], "acceleration_m_s2": [None]},
        {"time_s": [10**400], "acceleration_m_s2": [9.81]},
        {"time_s": [{}], "acceleration_m_s2": [9.81]},
        {"time_s": [[1.0], [1.0, 2.0]], "acceleration_m_s2": [9.81]},
    ],
)
def test_a_recording_of_others_with_no_course_is_refused(arguments: dict[str, Any]) -> None:
    with pytest.raises(DataError, match="motion: time_s and acceleration_m_s2 are not"):
        course_of(arguments)
