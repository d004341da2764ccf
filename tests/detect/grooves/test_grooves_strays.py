"""The posterior of waves and strays, beside dense matrices of the same model."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bench.texture.trials import slip_at
from tactiled.array import load_array
from tactiled.detect.grooves.estimator import JointParams, JointTexture
from tactiled.detect.grooves.model import ChannelLayout, WaveFit, WaveMotion, channel_layout
from tactiled.detect.grooves.stray_memory import LOG_PRIOR, SIGMAS_C, SIGMAS_T, LearntStrays, carried
from tactiled.detect.grooves.strays import weigh_waves
from tactiled.samples.block import Gap, regular_block

LAYOUT = channel_layout(load_array("wang2019-3x3"))
PLACE = np.stack([LAYOUT.x_mm - LAYOUT.x_mm.mean(), LAYOUT.y_mm - LAYOUT.y_mm.mean()], axis=1)
CENTRED = ChannelLayout(PLACE[:, 0], PLACE[:, 1], LAYOUT.kind)
TRUE = np.array([4.0, 1.5])
# Phase differences along a row are whole turns off by 0.22 rad: places 0, 3.5 and 7.3 mm.
RIVAL = TRUE + np.array([2 * np.pi / 3.65, 0.0])
ALONG_X = WaveMotion(2.0, 0.0, 0.0, 1.5)
UNKNOWN = WaveMotion(0.0, 0.0, 0.0, 1.5)
ALL = np.arange(36)


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


@pytest.mark.parametrize(("sigma_c", "sigma_t"), [(0.05, 0.0), (0.1, 0.06), (0.02, 0.2)])
@pytest.mark.parametrize("motion", [UNKNOWN, ALONG_X])
def test_weights_are_those_of_the_dense_gaussian_model(
    sigma_c: float, sigma_t: float, motion: WaveMotion
) -> None:
    """Unknown phases and corrections of k as Gaussians of huge variance in one dense covariance matrix."""
    z = phasors(np.random.default_rng(1), sigma_c, sigma_t)
    k = np.stack([TRUE, RIVAL])
    layout = dataclasses.replace(CENTRED, strays=LearntStrays(ALL, at(sigma_c, sigma_t)))
    found = weigh_waves(z, np.full(36, 1e-4), layout, k, motion, float(TRUE[0]), 0.05, 10.0)

    same = CENTRED.taxel[:, np.newaxis] == CENTRED.taxel
    noise = np.diag(1e-4 / np.abs(z) ** 2 + sigma_c**2) + sigma_t**2 * same
    log = []
    for each in k:
        left = np.angle(z * np.exp(-1j * (PLACE @ each)))
        for kind in range(4):  # the mean phase of a kind is free: any shift of it is as good
            mine = CENTRED.kind == kind
            left[mine] = np.angle(np.exp(1j * (left[mine] - np.angle(np.exp(1j * left[mine]).sum()))))
        unknown = np.concatenate([10.0 * CENTRED.is_kind, 10.0 * PLACE], axis=1)
        observed, covariance = 2 * np.sin(left / 2), noise + unknown @ unknown.T
        if motion.has_speed:
            slack = np.linalg.norm(
                [each[1] * np.radians(1.5), each[0] * np.sqrt(3) / 2 * np.radians(1.5) ** 2, 0.05]
            )
            rows = np.concatenate([unknown, 10.0 * np.array([[0, 0, 0, 0, 1.0, 0]])])
            covariance = rows @ rows.T
            covariance[:36, :36] += noise
            covariance[36, 36] += slack**2
            observed = np.append(observed, TRUE[0] - each[0])
        log.append(stats.multivariate_normal(np.zeros(len(observed)), covariance).logpdf(observed))
    odds = np.exp(log[1] - log[0])
    assert found.weights[1] / found.weights[0] == pytest.approx(odds, rel=1e-3, abs=1e-12)


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
                10.0,
            ).stray_rad
            for _ in range(20)
        ]
        assert np.mean(found) == pytest.approx(np.hypot(sigma_c, sigma_t), rel=0.2)


def test_what_earlier_slides_tell_of_strays_settles_more_windows() -> None:
    rng, k, variance = np.random.default_rng(2), np.stack([TRUE, RIVAL]), np.full(36, 1e-4)
    layout, alone, learnt = CENTRED, [], []
    for _ in range(300):
        z = phasors(rng, 0.13, 0.0)
        alone.append(weigh_waves(z, variance, CENTRED, k, UNKNOWN, 0.0, 0.0, 10.0).weights[0])
        found = weigh_waves(z, variance, layout, k, UNKNOWN, 0.0, 0.0, 10.0)
        learnt.append(found.weights[0])
        layout = dataclasses.replace(CENTRED, strays=LearntStrays(ALL, carried(found.log_sigmas)))
    assert np.sum(np.array(learnt) > 0.99) > np.sum(np.array(alone) > 0.99)
    assert min(learnt) > 0.01


def test_weights_mean_what_they_say() -> None:
    """Among waves that are weighted at 90 to 99 %, as many are right; strays drawn from the prior."""
    rng = np.random.default_rng(3)
    said, right = [], []
    cells = rng.choice(LOG_PRIOR.size, 1500, p=np.exp(LOG_PRIOR).ravel())
    for cell in cells:
        i, j = divmod(int(cell), len(SIGMAS_T))
        z = phasors(rng, float(SIGMAS_C[i]), float(SIGMAS_T[j]))
        k = np.stack([TRUE, RIVAL])
        weights = weigh_waves(z, np.full(36, 1e-4), CENTRED, k, UNKNOWN, 0.0, 0.0, 10.0).weights
        said.append(weights.max())
        right.append(weights.argmax() == 0)
    some = (np.array(said) > 0.9) & (np.array(said) < 0.99)
    assert some.sum() > 100
    expected = np.array(said)[some].mean()
    sd = np.sqrt(expected * (1 - expected) / some.sum())
    assert np.array(right)[some].mean() == pytest.approx(expected, abs=3 * sd)


def test_even_channels_and_an_exact_alias_are_ambiguous_not_uneven() -> None:
    z = phasors(np.random.default_rng(4), 0.3, 0.0)
    uneven = weigh_waves(z, np.full(36, 1e-4), CENTRED, np.stack([TRUE, RIVAL]), UNKNOWN, 0.0, 0.0, 10.0)
    assert uneven.error_if_alike < 1e-6 < 1 - uneven.weights.max()
    same = weigh_waves(z, np.full(36, 1e-4), CENTRED, np.stack([TRUE, TRUE]), UNKNOWN, 0.0, 0.0, 10.0)
    assert same.error_if_alike == pytest.approx(0.5)


def test_a_carried_prior_is_a_distribution_that_keeps_part_of_the_first_one() -> None:
    prior = np.exp(carried(at(0.1, 0.06)))
    assert prior.sum() == pytest.approx(1)
    assert (prior >= 0.0999 * np.exp(LOG_PRIOR)).all()
    assert prior.argmax() == np.ravel_multi_index((5, 2), prior.shape)


def test_the_online_estimator_learns_from_an_answer_and_forgets_at_a_gap() -> None:
    handed: list[LearntStrays | None] = []
    learnt = LearntStrays(ALL, carried(at(0.1, 0.0)))

    def recorded(*window: Any) -> WaveFit:
        handed.append(window[3].strays)
        return WaveFit("ok", 2.0, period_mm=1.0, strays=learnt)

    rng = np.random.default_rng(6)
    detector = JointTexture(load_array("wang2019-3x3"), JointParams(speed_mm_s=2.0), fit=recorded)
    first = regular_block(1 + 0.01 * rng.normal(size=(300, 36)), 100.0)
    detector.process(first, [slip_at(0.0, 0.0)])
    assert len(handed) > 3
    assert all(strays is None for strays in handed)
    handed.clear()
    later = regular_block(1 + 0.01 * rng.normal(size=(300, 36)), 100.0, start_s=3.0, index=300)
    detector.process(later, [slip_at(3.0, 0.0)])
    assert handed[-1] is learnt
    handed.clear()
    detector.process(Gap(300, "missing", 600))
    last = regular_block(1 + 0.01 * rng.normal(size=(300, 36)), 100.0, start_s=9.0, index=900)
    detector.process(last, [slip_at(9.0, 0.0)])
    assert handed[0] is None
