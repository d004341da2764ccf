"""Whether phases tell one wave from all others: taxels far apart, in a row, or in one place."""

import numpy as np
import pytest
from gratings import ARRAY, Grating, Slide, answer, assert_right, fit, grid, known, unknown

from tactiled.array import Array
from tactiled.detect.grooves.ambiguity import has_baseline
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import Refusal
from tactiled.detect.grooves.params import WaveParams

ROW = grid([0.0, 3.5, 7.0], [0.0])
COLUMN = grid([0.0], [0.0, 3.5, 7.0])
ALONG_X = WaveMotion(2.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("array", "motion", "expected"),
    [
        (ARRAY, ALONG_X, True),
        (ARRAY, ALONG_X.without_speed, True),
        (COLUMN, ALONG_X, True),  # the speed gives what lies along the motion, the column what lies across
        (COLUMN, ALONG_X.without_speed, False),
        (ROW, ALONG_X, False),  # all taxels lie along the motion: nothing is seen across it
        (grid([0.0], [0.0]), ALONG_X, False),
    ],
)
def test_baseline_is_needed_in_the_directions_that_matter(
    array: Array, motion: WaveMotion, expected: bool
) -> None:
    layout = channel_layout(array)
    assert has_baseline(layout, motion) is expected


def test_evenly_spaced_taxels_leave_readings_that_differ_by_whole_turns() -> None:
    """A column with one spacing of 3.5 mm: wave vectors that differ by 2 pi / 3.5 mm fit equally well."""
    slide = Slide((Grating(1.2, 20.0),))
    found = fit(slide, known(slide), COLUMN, params=WaveParams(max_tilt_deg=80))
    assert isinstance(found, Refusal)
    assert found.status == "ambiguous"
    assert max(c.weight for c in found.candidates) < 0.7
    across = np.array([
        2 * np.pi / c.period_mm * np.sin(np.radians(c.angle_deg)) for c in found.candidates
    ])  # fmt: skip
    true = 2 * np.pi / 1.2 * np.sin(np.radians(20.0))
    turns = (across - true) / (2 * np.pi / 3.5)
    assert np.abs(turns - np.round(turns)).max() < 0.05
    assert len(set(np.round(turns))) == len(found.candidates) > 1
    weights = [c.weight for c in found.candidates]
    assert weights == pytest.approx([weights[0]] * len(weights), rel=0.05)


def test_narrower_limits_of_the_angle_leave_one_reading() -> None:
    slide = Slide((Grating(1.2, 5.0),))
    assert fit(slide, known(slide), COLUMN, params=WaveParams(max_tilt_deg=80)).status == "ambiguous"
    # Neighbouring readings are about 19 degrees away.
    assert_right(fit(slide, known(slide), COLUMN, params=WaveParams(max_tilt_deg=12)), slide.gratings[0])


def test_uneven_spacing_tells_the_readings_apart() -> None:
    slide = Slide((Grating(1.2, 20.0),))
    for motion in (known(slide), unknown(slide)):
        found = answer(fit(slide, motion))
        assert_right(found, slide.gratings[0])
        assert found.error_probability <= WaveParams().error_probability
