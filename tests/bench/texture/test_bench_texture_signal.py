"""The bound against numbers that were found without it and laws that it must obey; drawn signals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.texture.signal import (
    ANGLES_DEG,
    LEVEL_VOLTS,
    PERIODS_MM,
    ArrayResponse,
    Grating,
    Wave,
    bound,
    draw_wave,
    readings,
    sensed_by,
    turns,
    wave_volts,
)
from tactiled.array import FloatArray


def column(snr_db: float) -> ArrayResponse:
    """Three taxels of one column, as in the first study of what limits the estimate."""
    sigma = np.sqrt(0.5 / 10 ** (snr_db / 10))
    return ArrayResponse(
        x_mm=np.zeros(3),
        y_mm=np.array([0.0, 3.5, 7.3]),
        offset_s=np.zeros(3),
        kind=np.zeros(3, dtype=np.int64),
        phase_rad=np.zeros(1),
        amplitude_volts=1.0,
        noise_volts=float(sigma),
    )


def scans(window_s: float) -> FloatArray:
    return np.arange(round(100 * window_s)) / 100.0


# Bounds of that study, of three taxels of a column: angle in degrees, period in um.
STUDY = [
    (10.0, 20.0, 15.0, 0.0067, 0.15),
    (10.0, 20.0, 30.0, 0.0068, 0.15),
    (10.0, 10.0, 45.0, 0.021, 0.45),
    (10.0, 0.0, 15.0, 0.067, 1.5),
]


@pytest.mark.parametrize(("window_s", "snr_db", "angle_deg", "angle_sd_deg", "period_sd_um"), STUDY)
def test_one_column_as_studied_before(
    window_s: float, snr_db: float, angle_deg: float, angle_sd_deg: float, period_sd_um: float
) -> None:
    least = bound(Wave(1.2, angle_deg, 1.0), column(snr_db), scans(window_s), is_speed_known=True)
    assert least.angle_sd_deg == pytest.approx(angle_sd_deg, rel=0.02)
    assert 1e3 * least.period_sd_mm == pytest.approx(period_sd_um, rel=0.05)  # given to two digits


def test_frequency_alone_has_the_classical_bound() -> None:
    # var(f) = 12 / ((2 pi)^2 snr n^3) for one sine, f in cycles a sample (Kay I, equation 3.41); three
    # channels have a third. At 0 degrees D = v / f, and the angle is orthogonal to it.
    n, snr_db = 5000, 10.0
    least = bound(Wave(1.2, 0.0, 1.0), column(snr_db), np.arange(n) / 100.0, is_speed_known=True)
    f_sd_hz = 100 * np.sqrt(12 / ((2 * np.pi) ** 2 * 10 ** (snr_db / 10) * float(n) ** 3 * 3))
    assert least.period_sd_mm == pytest.approx(1.2**2 * f_sd_hz, rel=1e-2)


def test_what_cannot_be_known_is_infinite() -> None:
    least = bound(Wave(1.2, 15.0, 1.0), column(20.0), scans(10), is_speed_known=False)
    assert np.isinf(least).all()
    one = ArrayResponse(**vars(column(20.0)) | {"y_mm": np.zeros(3)})
    assert np.isinf(bound(Wave(1.2, 15.0, 1.0), one, scans(10), is_speed_known=True).angle_sd_deg)
    whole = sensed_by(np.random.default_rng(0), 20.0)
    known = bound(Wave(1.2, 15.0, 1.0), whole, scans(10), is_speed_known=False)
    assert np.isfinite(known).all()


@settings(max_examples=25, deadline=None)
@given(
    period_mm=st.floats(0.6, 6.0),
    angle_deg=st.floats(-75, 75),
    speed_mm_s=st.floats(1.0, 5.0),
    seed=st.integers(0, 1000),
)
def test_more_is_never_worse(period_mm: float, angle_deg: float, speed_mm_s: float, seed: int) -> None:
    wave = Wave(period_mm, angle_deg, speed_mm_s)
    rng = np.random.default_rng(seed)
    plain = sensed_by(rng, 20.0)
    quiet = ArrayResponse(**vars(plain) | {"noise_volts": plain.noise_volts / 10})
    known = bound(wave, plain, scans(4), is_speed_known=True)
    unknown = bound(wave, plain, scans(4), is_speed_known=False)
    longer = bound(wave, plain, scans(8), is_speed_known=True)
    assert known.period_sd_mm <= unknown.period_sd_mm * (1 + 1e-6)
    assert known.angle_sd_deg <= unknown.angle_sd_deg * (1 + 1e-6)
    assert longer.period_sd_mm < known.period_sd_mm
    assert bound(wave, quiet, scans(4), is_speed_known=True).angle_sd_deg == pytest.approx(
        known.angle_sd_deg / 10, rel=1e-6
    )


def test_derivatives_are_those_of_the_signal() -> None:
    # The information about D alone, all else known, from differences of the signal itself.
    rng = np.random.default_rng(3)
    sensed = sensed_by(rng, 20.0)
    wave, time_s, step = Wave(1.7, 25.0, 1.3, 10.0), scans(3), 1e-6
    ends = [wave_volts(Wave(1.7 + d, 25.0, 1.3, 10.0), sensed, time_s) for d in (step, -step)]
    alone = 1 / np.linalg.norm((ends[0] - ends[1]) / (2 * step) / sensed.noise_volts)
    # The angle and the amplitudes are not known, either, which costs a fifth.
    assert alone < bound(wave, sensed, time_s, is_speed_known=True).period_sd_mm < 1.5 * alone


def test_signal_is_its_own_model() -> None:
    rng = np.random.default_rng(1)
    sensed = sensed_by(rng, 20.0)
    wave, time_s = Wave(1.2, 30.0, 1.0), scans(20)
    flat = np.column_stack([np.full(36, LEVEL_VOLTS), np.zeros(36)])
    volts = readings(Grating(wave, sensed, flat, time_s), rng)
    ripple = wave_volts(wave, sensed, time_s)
    assert np.std(volts - LEVEL_VOLTS - ripple, axis=0) == pytest.approx(
        np.full(36, sensed.noise_volts), rel=0.1
    )
    snr = (ripple**2).mean(axis=0) / sensed.noise_volts**2
    assert 10 * np.log10(snr) == pytest.approx(np.full(36, 20.0), abs=0.3)
    assert np.ptp(turns(wave, sensed, time_s)[:, 0]) == pytest.approx(wave.frequency_hz * 19.99)


@given(st.integers(0, 500))
def test_gratings_are_those_of_the_grid(seed: int) -> None:
    wave = draw_wave(np.random.default_rng(seed))
    assert PERIODS_MM[0] <= wave.period_mm <= PERIODS_MM[1]
    assert abs(wave.angle_deg - wave.direction_deg) <= ANGLES_DEG[1]
    assert 0 < wave.frequency_hz < 20  # 75 degrees or less: the skin crosses grooves forwards
