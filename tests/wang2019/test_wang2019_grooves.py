"""The published equations on sines of known period and angle, and their refusals."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled.array import FloatArray
from tactiled.wang2019.grooves import GrooveEstimate, GrooveLimits, SlidingMotion, estimate
from tactiled.wang2019.spectrum import spectrum

STEP = 8.0 / 2**23
COLUMN_MM = np.array([0.0, 3.5, 7.3])


@dataclass(frozen=True)
class Sines:
    """Readings of a column of taxels over grooves; independent of the estimators' code."""

    period_mm: float = 1.2
    angle_deg: float = 0.0
    direction_deg: float = 0.0
    speed_mm_s: float = 1.0
    places_mm: tuple[float, ...] = (0.0, 3.5, 7.3)
    offsets_s: tuple[float, ...] = (0.0, 0.0, 0.0)
    snr_db: float = 20.0
    window_s: float = 10.0
    rate_hz: float = 100.0
    seed: int = 0

    def volts(self) -> FloatArray:
        rng = np.random.default_rng(self.seed)
        t = np.arange(round(self.window_s * self.rate_hz))[:, np.newaxis] / self.rate_hz + np.array(
            self.offsets_s
        )
        a, theta = np.radians(self.angle_deg), np.radians(self.direction_deg)
        x = self.speed_mm_s * t * np.cos(theta) + rng.uniform(0, 5)
        y = self.speed_mm_s * t * np.sin(theta) + np.array(self.places_mm)
        wave = 0.05 * np.cos(2 * np.pi * (x * np.cos(a) + y * np.sin(a)) / self.period_mm)
        noise = 0.05 / np.sqrt(2) * 10 ** (-self.snr_db / 20) * rng.normal(size=wave.shape)
        volts: FloatArray = 1.0 + 0.002 * t + wave + noise
        return volts

    def estimate(self, params: GrooveLimits | None = None, direction_sd_deg: float = 0.0) -> GrooveEstimate:
        return estimate(
            self.volts(),
            self.rate_hz,
            STEP,
            np.array(self.places_mm),
            np.array(self.offsets_s),
            SlidingMotion(self.speed_mm_s, 0.0, self.direction_deg, direction_sd_deg),
            params or GrooveLimits(),
        )


def answers(sines: list[Sines]) -> list[tuple[Sines, GrooveEstimate]]:
    return [(s, found) for s in sines if (found := s.estimate()).status == "ok"]


@pytest.mark.parametrize(
    ("period_mm", "angle_deg"),
    [
        (0.9, 0.0),
        (1.2, 0.0),
        (1.5, 0.0),
        (1.2, 15.0),
        (1.2, 30.0),
        (1.2, 45.0),
        (1.2, 60.0),
        (1.2, -30.0),
        (1.2, -60.0),
    ],
)
def test_table_of_the_paper_within_the_stated_resolution(period_mm: float, angle_deg: float) -> None:
    found = answers([Sines(period_mm, angle_deg, seed=seed) for seed in range(20)])
    assert found, "twenty windows, and not one agreement"
    for _, grooves in found:
        assert abs(grooves.period_mm - period_mm) <= 3 * grooves.period_sd_mm
        assert abs(grooves.angle_deg - angle_deg) <= 3 * grooves.angle_sd_deg
        # Table 2: up to 9.2 % in period; 23.3 % of 15 degrees in angle.
        assert abs(grooves.period_mm - period_mm) <= 0.092 * period_mm
        assert abs(grooves.angle_deg - angle_deg) <= 3.5
        assert abs(grooves.frequency_hz - np.cos(np.radians(angle_deg)) / period_mm) <= 0.1


@given(
    period_mm=st.floats(0.4, 2.5),
    angle_deg=st.floats(-65, 65),
    direction_deg=st.sampled_from([0.0, 180.0, 25.0, -25.0, 155.0, -160.0]),
    speed_mm_s=st.sampled_from([1.0, 3.0]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=60, deadline=None)
def test_any_motion_any_angle_within_four_sigma(
    period_mm: float, angle_deg: float, direction_deg: float, speed_mm_s: float, seed: int
) -> None:
    sines = Sines(period_mm, angle_deg, direction_deg, speed_mm_s, seed=seed)
    grooves = sines.estimate()
    true_hz = speed_mm_s * abs(np.cos(np.radians(direction_deg - angle_deg))) / period_mm
    if true_hz < 0.35:
        return  # three periods or less: covered by another test
    assert grooves.status in ("ok", "ambiguous")
    if grooves.status == "ok":
        assert abs(grooves.angle_deg - angle_deg) <= 4 * grooves.angle_sd_deg
        assert abs(grooves.period_mm - period_mm) <= 4 * grooves.period_sd_mm


def test_sigmas_cover() -> None:
    rng = np.random.default_rng(2)
    sines = [
        Sines(rng.uniform(0.9, 1.6), rng.uniform(-60, 60), 0.0, 1.0, seed=seed, snr_db=rng.uniform(10, 30))
        for seed in range(300)
    ]
    found = answers(sines)
    angle = np.array([(g.angle_deg - s.angle_deg) / g.angle_sd_deg for s, g in found])
    period = np.array([(g.period_mm - s.period_mm) / g.period_sd_mm for s, g in found])
    assert len(found) > 100
    # Grid errors are uniform, not normal: the rms must lie between half and 1.5 times its value.
    assert 0.5 < np.sqrt((angle**2).mean()) < 1.5
    assert 0.5 < np.sqrt((period**2).mean()) < 1.5


def test_scan_skew_is_taken_off() -> None:
    skewed = Sines(1.2, 10.0, speed_mm_s=4.0, offsets_s=(0.0, 0.003, 0.009), snr_db=40.0, rate_hz=1000.0)
    found = skewed.estimate()
    assert found.status == "ok"
    assert abs(found.angle_deg - 10.0) <= 3 * found.angle_sd_deg
    ignored = estimate(
        skewed.volts(),
        1000.0,
        STEP,
        COLUMN_MM,
        np.zeros(3),
        SlidingMotion(4.0, 0.0, 0.0, 0.0),
        GrooveLimits(agreement_mm=1.0),
    )
    assert abs(ignored.angle_deg - 10.0) > 3 * ignored.angle_sd_deg


@pytest.mark.parametrize("places_mm", [(0.0, 4.0, 8.0), (0.0, 4.0)])
def test_equal_gaps_and_two_taxels_are_ambiguous(places_mm: tuple[float, ...]) -> None:
    offsets_s = (0.0,) * len(places_mm)
    found = Sines(
        20.0, 20.0, speed_mm_s=10.0, places_mm=places_mm, offsets_s=offsets_s, snr_db=30.0
    ).estimate()
    assert found.status == "ambiguous"


@pytest.mark.parametrize(
    ("sines", "status"),
    [
        (Sines(snr_db=-40.0), "low-snr"),
        (Sines(period_mm=6.0), "too-few-periods"),
        (Sines(period_mm=12.0), "too-few-periods"),
        (Sines(period_mm=1.2, speed_mm_s=56.0), "aliased"),
        (Sines(period_mm=1.2, speed_mm_s=60.0), "aliased"),
        (Sines(period_mm=1.2, speed_mm_s=30.0), "aliased"),  # 25 Hz, above the low-pass
        (Sines(direction_deg=90.0, angle_deg=45.0), "ambiguous"),
    ],
)
def test_refusals(sines: Sines, status: str) -> None:
    found = sines.estimate()
    assert found.status == status
    assert (found.period_mm, found.period_sd_mm, found.angle_deg, found.angle_sd_deg) == (0, 0, 0, 0)


@pytest.mark.parametrize("true_hz", [21.0, 25.0, 30.0, 33.3, 41.7, 45.0])
def test_a_ripple_above_the_low_pass_is_not_taken_for_its_mirrored_harmonics(true_hz: float) -> None:
    t = np.arange(1000)[:, np.newaxis] / 100.0 + np.zeros(3)
    ripple = sum(
        size * np.cos(2 * np.pi * k * true_hz * t) for k, size in ((1, 0.05), (2, 0.01), (3, 0.0025))
    )
    creep = 0.05 * (1 - np.exp(-t / 5.0))
    noise = 0.3e-3 * np.random.default_rng(1).normal(size=t.shape)
    volts = 1.0 + creep + ripple + noise
    seen = spectrum(volts, 100.0, STEP, 20.0)
    assert seen.status == "aliased"
    assert seen.peak_hz == pytest.approx(true_hz, abs=0.1)


@pytest.mark.parametrize(
    ("places_mm", "period_mm", "angle_deg"),
    [
        ((0.0, 3.5, 7.3), 0.5, 65.0),
        ((0.0, 3.5, 7.3), 0.4, 50.0),
        ((0.0, 3.5, 7.3), 0.4, -60.0),
        ((0.0, 3.5, 10.0), 1.2, 5.0),
        ((0.0, 3.5, 10.0), 1.2, 15.0),
        ((0.0, 3.5, 10.0), 1.2, -45.0),
    ],
)
def test_unequal_gaps_list_every_reading_that_fits(
    places_mm: tuple[float, ...], period_mm: float, angle_deg: float
) -> None:
    found = Sines(period_mm, angle_deg, places_mm=places_mm, snr_db=30.0).estimate()
    assert found.status == "ambiguous"
    assert len(found.candidates) > 1
    nearest = min(found.candidates, key=lambda c: abs(c.angle_deg - angle_deg))
    assert abs(nearest.angle_deg - angle_deg) < 2.0
    assert nearest.period_mm == pytest.approx(period_mm, rel=0.1)


def test_the_limits_decide_what_is_ambiguous() -> None:
    sines = Sines(0.5, 65.0, snr_db=30.0)  # or 0.58 mm at -62 degrees
    assert sines.estimate(GrooveLimits(max_angle_deg=63.0, agreement_mm=1.0)).angle_deg < 0
    assert sines.estimate(GrooveLimits(min_period_mm=0.54, agreement_mm=1.0)).angle_deg < 0
    both = sines.estimate(GrooveLimits(agreement_mm=1.0))
    assert [np.sign(c.angle_deg) for c in both.candidates] == [-1, 1]


def test_every_plate_above_the_stated_period_has_one_reading() -> None:
    """At 65 degrees l / cos A is 0.71 mm; maximum and minimum may disagree, which is not tested here."""
    rng = np.random.default_rng(8)
    for seed in range(100):
        sines = Sines(rng.uniform(0.95, 2.5), rng.uniform(-60, 60), seed=seed, snr_db=30.0)
        found = sines.estimate(GrooveLimits(agreement_mm=1.0))
        if found.status != "too-few-periods":
            assert found.status == "ok", sines


def test_unknown_direction_is_ambiguous() -> None:
    assert Sines().estimate(direction_sd_deg=180.0).status == "ambiguous"


@pytest.mark.parametrize("n", [1, 2, 3, 4, 8, 50, 1000])
@pytest.mark.parametrize("kind", ["zeros", "constant", "ramp", "lsb", "impulse", "nyquist"])
def test_anything_finite_gives_something_finite(n: int, kind: str) -> None:
    k = np.arange(n)[:, np.newaxis] + np.zeros(3)
    volts = {
        "zeros": 0.0 * k,
        "constant": 0 * k + 3.0,
        "ramp": 0.001 * k,
        "lsb": np.floor(k / 7) % 2 * 3.0 / 4096 + 3.0,
        "impulse": (k == n // 2) * 1.0,
        "nyquist": np.cos(np.pi * k),
    }[kind]
    found = estimate(
        volts, 100.0, STEP, COLUMN_MM, np.zeros(3), SlidingMotion(1.0, 0.0, 0.0, 0.0), GrooveLimits()
    )
    numbers = [
        found.frequency_hz,
        found.snr_db,
        found.period_mm,
        found.period_sd_mm,
        found.angle_deg,
        found.angle_sd_deg,
    ]
    assert np.isfinite(numbers).all()
    if kind in ("zeros", "constant", "ramp"):
        assert found.status == "low-snr"
