"""Whether phases tell one wave from all others, and its posterior beside dense matrices of the same model."""

from unittest import mock

import numpy as np
import pytest
from gratings import ARRAY, Grating, Slide, fit, grid, known
from scipy import linalg, stats

from tactiled.array import Array
from tactiled.detect.grooves import ambiguity
from tactiled.detect.grooves.ambiguity import LOG_PRIOR, SIGMAS_C, SIGMAS_T, has_baseline, weigh_waves
from tactiled.detect.grooves.model import ChannelLayout, WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import Refusal
from tactiled.detect.grooves.params import WaveParams

LAYOUT = channel_layout(ARRAY)
PLACE = np.stack([LAYOUT.x_mm - LAYOUT.x_mm.mean(), LAYOUT.y_mm - LAYOUT.y_mm.mean()], axis=1)
CENTRED = ChannelLayout(PLACE[:, 0], PLACE[:, 1], LAYOUT.kind)
TRUE = np.array([4.0, 1.5])
# Phase differences along a row are whole turns off by 0.22 rad: places 0, 3.5 and 7.3 mm.
RIVAL = TRUE + np.array([2 * np.pi / 3.65, 0.0])
ALONG_X = WaveMotion(2.0, 0.0, 0.0, 1.5)
UNKNOWN = WaveMotion(0.0, 0.0, 0.0, 1.5)


def phasors(rng: np.random.Generator, sigma_c: float, sigma_t: float, noise: float = 0.01) -> np.ndarray:
    taxel = CENTRED.taxel
    stray = sigma_c * rng.normal(size=36) + sigma_t * rng.normal(size=9)[taxel]
    z = np.exp(1j * (PLACE @ TRUE + CENTRED.kind + stray))
    return np.asarray(z + noise * (rng.normal(size=36) + 1j * rng.normal(size=36)))


def at(sigma_c: float, sigma_t: float) -> np.ndarray:
    """Return the prior of one cell of the grid."""
    log = np.full(LOG_PRIOR.shape, -np.inf)
    log[np.abs(SIGMAS_C - sigma_c).argmin(), np.abs(SIGMAS_T - sigma_t).argmin()] = 0.0
    return log


ROW, COLUMN = grid([0.0, 3.5, 7.0], [0.0]), grid([0.0], [0.0, 3.5, 7.0])


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


@pytest.mark.parametrize(("sigma_c", "sigma_t"), [(0.05, 0.0), (0.1, 0.06), (0.02, 0.2)])
@pytest.mark.parametrize("motion", [UNKNOWN, ALONG_X])
def test_weights_and_covariance_are_those_of_the_dense_gaussian_model(
    sigma_c: float, sigma_t: float, motion: WaveMotion
) -> None:
    """Unknown phases and corrections of k as Gaussians of huge variance in one dense covariance matrix."""
    z = phasors(np.random.default_rng(1), sigma_c, sigma_t)
    k = np.stack([TRUE, RIVAL])
    with mock.patch.object(ambiguity, "LOG_PRIOR", at(sigma_c, sigma_t)):
        found = weigh_waves(z, np.full(36, 1e-4), CENTRED, k, motion, float(TRUE[0]), 0.05)

    same = CENTRED.taxel[:, np.newaxis] == CENTRED.taxel
    noise = np.diag(1e-4 / np.abs(z) ** 2 + sigma_c**2) + sigma_t**2 * same
    log, covariances = [], []
    for each in k:
        left = np.angle(z * np.exp(-1j * (PLACE @ each)))
        for kind in range(4):  # the mean phase of a kind is free: any shift of it is as good
            mine = CENTRED.kind == kind
            left[mine] = np.angle(np.exp(1j * (left[mine] - np.angle(np.exp(1j * left[mine]).sum()))))
        unknown = np.concatenate([10.0 * CENTRED.is_kind, 10.0 * PLACE], axis=1)
        observed, rows, own = 2 * np.sin(left / 2), unknown, noise
        if motion.has_speed:
            slack = np.linalg.norm(
                [each[1] * np.radians(1.5), each[0] * np.sqrt(3) / 2 * np.radians(1.5) ** 2, 0.05]
            )
            rows = np.concatenate([unknown, 10.0 * np.array([[0, 0, 0, 0, 1.0, 0]])])
            own = linalg.block_diag(noise, np.array([[slack**2]]))
            observed = np.append(observed, TRUE[0] - each[0])
        covariance = own + rows @ rows.T
        covariances.append(100 * np.linalg.inv(rows.T @ np.linalg.inv(own) @ rows + np.eye(6))[-2:, -2:])
        log.append(stats.multivariate_normal(np.zeros(len(observed)), covariance).logpdf(observed))
    odds = np.exp(log[1] - log[0])
    assert found.weights[1] / found.weights[0] == pytest.approx(odds, rel=1e-3, abs=1e-12)
    assert found.covariance == pytest.approx(covariances[int(odds > 1)], rel=1e-6)


def test_strays_of_channels_and_taxels_are_found() -> None:
    for sigma_c, sigma_t in ((0.05, 0.0), (0.15, 0.0), (0.3, 0.0), (0.1, 0.2)):
        rng = np.random.default_rng(5)
        found = [
            weigh_waves(
                phasors(rng, sigma_c, sigma_t),
                np.full(36, 1e-4),
                CENTRED,
                TRUE[np.newaxis],
                UNKNOWN,
                0.0,
                0.0,
            ).stray_rad
            for _ in range(20)
        ]
        assert np.mean(found) == pytest.approx(np.hypot(sigma_c, sigma_t), rel=0.2)


def test_weights_mean_what_they_say() -> None:
    """Among waves that are weighted at 90 to 99 %, as many are right; strays drawn from the prior."""
    rng = np.random.default_rng(3)
    said, right = [], []
    cells = rng.choice(LOG_PRIOR.size, 1500, p=np.exp(LOG_PRIOR).ravel())
    for cell in cells:
        i, j = divmod(int(cell), len(SIGMAS_T))
        z = phasors(rng, float(SIGMAS_C[i]), float(SIGMAS_T[j]))
        k = np.stack([TRUE, RIVAL])
        weights = weigh_waves(z, np.full(36, 1e-4), CENTRED, k, UNKNOWN, 0.0, 0.0).weights
        said.append(weights.max())
        right.append(weights.argmax() == 0)
    some = (np.array(said) > 0.9) & (np.array(said) < 0.99)
    assert some.sum() > 100
    expected = np.array(said)[some].mean()
    sd = np.sqrt(expected * (1 - expected) / some.sum())
    assert np.array(right)[some].mean() == pytest.approx(expected, abs=3 * sd)


def test_even_channels_and_an_exact_alias_are_ambiguous_not_uneven() -> None:
    z = phasors(np.random.default_rng(4), 0.3, 0.0)
    uneven = weigh_waves(z, np.full(36, 1e-4), CENTRED, np.stack([TRUE, RIVAL]), UNKNOWN, 0.0, 0.0)
    assert uneven.error_if_alike < 1e-6 < 1 - uneven.weights.max()
    same = weigh_waves(z, np.full(36, 1e-4), CENTRED, np.stack([TRUE, TRUE]), UNKNOWN, 0.0, 0.0)
    assert same.error_if_alike == pytest.approx(0.5)
