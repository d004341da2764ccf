"""When a growth began, of all that the contact showed."""

import numpy as np
import pytest

from tactiled.array import FloatArray
from tactiled.detect.slip.history import ResponseHistory

ALONG = np.array([0.6, 0.8, 0.0])
WINDOW, LONGEST_RAMP = 144, 128
PRESSURE = 1e-6  # so small that any growth is one


def rows(course: FloatArray) -> FloatArray:
    """Responses of motion along `ALONG`."""
    out = np.zeros((len(course), 7))
    out[:, :3], out[:, 6] = course[:, np.newaxis] * ALONG, PRESSURE
    return out


def test_what_grew_since_long_before_the_window_began_then() -> None:
    rng = np.random.default_rng(1)
    scans = np.arange(1500.0)
    errors = []
    for _ in range(30):
        delay = rng.uniform(400, 1200)
        past, course = (
            ResponseHistory(100.0, LONGEST_RAMP),
            rows(np.maximum(scans - (1499 - delay), 0) + rng.normal(size=1500)),
        )
        for row in course:
            past.take(row[np.newaxis])
        kink = past.began(course[-WINDOW:], LONGEST_RAMP, 1500, ALONG, 1.0)
        errors.append((kink.delay_scans - delay) / kink.sd_scans)
        assert kink.sd_scans < 20
    assert np.mean(np.abs(errors) < 1) > 0.5
    assert np.abs(errors).max() < 4


def test_what_is_told_already_has_nothing_to_do_with_it() -> None:
    scans = np.arange(1500.0)
    course = rows(np.where(scans < 1000, scans, 0.0) + np.maximum(scans - 1300, 0))
    past = ResponseHistory(100.0, LONGEST_RAMP)
    for row in course:
        past.take(row[np.newaxis])
    kink = past.began(course[-WINDOW:], LONGEST_RAMP, 400, ALONG, 1.0)
    assert kink.delay_scans == pytest.approx(199, abs=3)


@pytest.mark.parametrize("forgets", [False, True])
def test_other_taxels_shift_the_past_too_and_a_lift_clears_it(forgets: bool) -> None:
    scans = np.arange(1500.0)
    course = np.maximum(scans - 900, 0)
    past, before = ResponseHistory(100.0, LONGEST_RAMP), rows(course[:1003])
    for row in before:
        past.take(row[np.newaxis])
    if forgets:
        past.forget()
    past.shift(rows(np.array([5000.0]))[0])
    after = rows(course + 5000.0)
    for row in after[1003:]:
        past.take(row[np.newaxis])
    kink = past.began(after[-WINDOW:], LONGEST_RAMP, 1500, ALONG, 1.0)
    if forgets:
        assert kink.delay_scans <= 497
    else:
        assert kink.delay_scans == pytest.approx(599, abs=5)
