"""The table of rates in `detect.slip.alarm_rate`, and the command that makes it."""

import itertools

import pytest

from bench.slip.hand import SHEARS, curve, one_scene
from tactiled.detect.slip.alarm_rate import PER_HOUR, SHEAR, rate_at, shear_at
from tactiled.detect.slip.detector import SETTINGS, CoherentParams
from tactiled.emulator.scene.families import QUIET


def test_families_have_equal_weight_and_the_curve_is_monotonic() -> None:
    noisy = (*(10.0 - k for k in range(len(SHEARS) - 1)), 8.0)
    parts = [(family, 0.1 if family == "taps" else 1.0, (0.0,) * len(SHEARS)) for family in QUIET]
    found = curve(iter([*parts, ("taps", 0.1, noisy)]))
    assert found[0] == pytest.approx(10.0 / 0.2 / len(QUIET))
    assert all(a >= b for a, b in itertools.pairwise(found))


def test_one_scene_returns_its_hours_and_alarms() -> None:
    family, hours, counts = one_scene("load-and-back", 1001)
    assert family == "load-and-back"
    assert 0.002 < hours < 0.02
    assert counts[0] >= counts[-1] == 0


def test_the_detector_s_table_has_the_same_shears_and_is_monotonic() -> None:
    assert tuple(sorted(SHEARS, reverse=True)) == SHEAR
    assert list(PER_HOUR) == sorted(PER_HOUR)
    rates = (0.01, *PER_HOUR, 3600.0)
    assert all(shear_at(a) >= shear_at(b) for a, b in itertools.pairwise(rates))
    assert [shear_at(rate) for rate in PER_HOUR] == pytest.approx(SHEAR)
    assert [rate_at(shear) for shear in SHEAR] == pytest.approx(PER_HOUR)
    assert (shear_at(0.01), shear_at(3600.0)) == pytest.approx((SHEAR[0], SHEAR[-1]))


def test_settings_are_rates_on_the_curve() -> None:
    assert all(params.least_shear is None for params in SETTINGS.values())
    assert [params.shear for params in SETTINGS.values()] == sorted(p.shear for p in SETTINGS.values())
    given = CoherentParams(false_alarms_per_hour=20.0, least_shear=0.3)
    assert (given.shear, given.noise_per_hour) == (0.3, 20.0)
    assert SETTINGS["fast"].noise_per_hour < 1
