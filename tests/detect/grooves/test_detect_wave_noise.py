"""Sigmas of the joint fit where ripples have more harmonics than the model."""

import numpy as np
import pytest
from gratings import ARRAY, Grating, Slide, fit, known


@pytest.mark.parametrize("period_mm", [1.75, 1.8, 1.85])
def test_rounding_does_not_choose_the_noise_that_counts(period_mm: float) -> None:
    # A fourth harmonic, which is not fitted, is noise of very uneven density: sigmas show where it was read.
    grating = Grating(period_mm, 20.0, 0.05, (1.0, 0.3, 0.2, 0.2))
    slide = Slide((grating,), duration_s=3.6, noise=0.002)
    volts = slide.volts(ARRAY)
    found = [
        fit(slide, known(slide), volts=volts + 1e-8 * np.random.default_rng(seed).normal(size=volts.shape))
        for seed in range(8)
    ]
    assert {one.status for one in found} == {"ok"}
    assert [one.angle_sd_deg for one in found] == pytest.approx([found[0].angle_sd_deg] * 8, rel=1e-2)
