"""Resolved gratings of doctor and check-config, against brute force and against the joint fit."""

from pathlib import Path

import numpy as np
import pytest

from bench.texture.signal import AMPLITUDE_VOLTS, LEVEL_VOLTS, Wave, sensed_by, turns
from tactiled.array import Array, FloatArray, load_array
from tactiled.cli import main
from tactiled.config import load_config
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import GrooveAnswer, Refusal
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.grooves.window import FitWindow
from tactiled.doctor.abilities import check_waves
from tactiled.doctor.ranges import ranges, rivals
from tactiled.doctor.unplugged import resolved_in_words

WANG = load_array("wang2019-3x3")
EQUAL = load_array("normal-3x3")
ALONG_X = JointParams(direction_deg=0.0)


def apart_rad(array: Array, per_mm: FloatArray) -> float:
    """Compute the phase difference of two waves, rms, without a common phase, by brute force."""
    phase = np.stack([array.x_mm, array.y_mm], axis=1) @ per_mm
    tried = phase[:, None] - np.linspace(-np.pi, np.pi, 721)
    return float(np.sqrt((np.angle(np.exp(1j * tried)) ** 2).mean(axis=0)).min())


@pytest.mark.parametrize("across_deg", [None, 90.0, 70.0])
def test_all_pairs_of_indistinguishable_waves_are_listed(across_deg: float | None) -> None:
    rng = np.random.default_rng(4)
    found, apart = rivals(WANG, 1.0, 0.4, across_deg)
    for per_mm, said in zip(found, apart, strict=True):
        assert apart_rad(WANG, per_mm) == pytest.approx(said, abs=0.005)
    for _ in range(20_000):
        size, angle = rng.uniform(2 * np.pi / 7.3, 4 * np.pi), rng.uniform(-np.pi, np.pi)
        angle = angle if across_deg is None else np.radians(across_deg)
        per_mm = size * np.array([np.cos(angle), np.sin(angle)])
        phase = np.stack([WANG.x_mm, WANG.y_mm], axis=1) @ per_mm
        spread = np.sqrt(-2 * np.log(np.abs(np.exp(1j * phase).mean())))  # rms, for small ones
        if spread < 0.2:
            near = min(np.linalg.norm(found - s * per_mm, axis=1).min() for s in (1, -1))
            assert near < 0.2  # phases of 0.4 rad over 3 mm


def test_unequal_gaps_resolve_what_equal_gaps_cannot() -> None:
    """3.5 and 3.8 mm: dk = 2 pi / 3.65 mm leaves a residue of 0.15 / 3.65 turns at one row of three."""
    residues = 2 * np.pi * np.array([0.0, 3.5 / 3.65 - 1, 0.0])
    assert rivals(WANG, 2.0, 0.3, 90.0)[1].min() == pytest.approx(np.std(residues), abs=0.005)
    assert rivals(EQUAL, 2.0, 0.3, 90.0)[1].min() < 1e-9
    assert not any(one.alike or one.is_empty for one in ranges(WANG, ALONG_X, 100.0, 0.0))
    assert all(one.is_empty and one.alike for one in ranges(EQUAL, ALONG_X, 100.0, 0.0))


def test_the_example_pair_has_equal_phases_and_frequency() -> None:
    for speed_mm_s in (0.0, 5.0):
        for one in ranges(EQUAL, ALONG_X, 100.0, speed_mm_s):
            k, other = (
                2 * np.pi / mm * np.array([np.cos(np.radians(deg)), np.sin(np.radians(deg))])
                for mm, deg in one.alike
            )
            assert apart_rad(EQUAL, k - other) < 0.07
            assert abs(one.alike[0][1]) == pytest.approx(one.tilt_deg)
            if speed_mm_s:
                assert k[0] == pytest.approx(other[0], rel=1e-3)


def fitted(
    array: Array, params: JointParams, period_mm: float, angle_deg: float, seed: int
) -> GrooveAnswer | Refusal:
    """Two seconds with eight ripples at 20 dB, with phase errors of 0.05 rad per channel; motion known."""
    rng = np.random.default_rng(seed)
    wave = Wave(period_mm, angle_deg, 4 * period_mm / float(np.cos(np.radians(angle_deg))))
    sensed, time_s = sensed_by(array, rng, 20.0, ()), np.arange(200) / 100
    phase_errors = 0.05 * rng.standard_normal(array.n_channels)
    ripple = np.cos(2 * np.pi * turns(wave, sensed, time_s) + sensed.phase_rad[sensed.kind, 0] + phase_errors)
    noise = sensed.noise_volts * rng.standard_normal(ripple.shape)
    motion = WaveMotion(wave.speed_mm_s, 0.0, 0.0, 0.0)
    volts = LEVEL_VOLTS + AMPLITUDE_VOLTS * ripple + noise
    return fit_wave(FitWindow(volts, time_s, sensed.offset_s, channel_layout(array), motion, params))


@pytest.mark.parametrize("seed", range(4))
def test_the_joint_fit_resolves_the_same_gratings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    narrow = JointParams(direction_deg=0.0, min_period_mm=5.0, max_tilt_deg=30.0)
    told = [(WANG, ALONG_X, 0.6, 60.0), (EQUAL, narrow, 5.5, 20.0)]
    for array, params, least_mm, most_deg in told:
        assert not any(one.alike for one in ranges(array, params, 100.0, 0.0))
        period_mm, angle_deg = float(rng.uniform(least_mm, 10.0)), float(rng.uniform(-most_deg, most_deg))
        found = fitted(array, params, period_mm, angle_deg, seed)
        assert isinstance(found, GrooveAnswer)
        assert found.period_mm == pytest.approx(period_mm, rel=0.05)
        assert fitted(EQUAL, ALONG_X, period_mm, angle_deg, seed).status == "ambiguous"


def test_speed_bounds_the_finest_and_the_coarsest_period() -> None:
    zero, thirty, sixty, _ = ranges(WANG, ALONG_X, 100.0, 30.0)
    assert [zero.from_mm, thirty.from_mm] == pytest.approx([30 / 45, 30 / 45 * np.sqrt(0.75)])
    assert [sixty.from_mm, zero.to_mm] == [0.5, 20.0]
    slow = ranges(WANG, ALONG_X, 100.0, 1.0)[0]
    assert slow.to_mm == pytest.approx(1.0 * 8 / 0.8)  # 8 s, 0.8 ripples


def test_findings_name_periods_speeds_and_options() -> None:
    grooves, speeds = check_waves(WANG, JointParams(), 100.0, 1.5)
    assert grooves.verdict == speeds.verdict == "ok"
    assert "at 1.5 mm/s, resolves 0.5 to 15 mm at 0 deg" in grooves.words
    assert "2 mm/s or faster for 20 mm" in speeds.words
    assert "rad" not in grooves.words + speeds.words
    grooves, fast = check_waves(WANG, JointParams(), 100.0, 60.0)
    assert fast.verdict == "warn"
    assert "below 1.33 mm" in fast.words
    assert fast.remedy.startswith("slide at 22.5 mm/s or slower for 0.5 mm")
    poor, _ = check_waves(EQUAL, ALONG_X, 100.0, 0.0)
    assert poor.verdict == "warn"
    assert "resolves no grooves at 0 to 75 deg" in poor.words
    assert "the same phases as" in poor.words
    assert "set the speed" in poor.remedy
    assert "min_period_mm = 5 and max_tilt_deg = 30" in poor.remedy
    assert "unequal gaps" in poor.remedy


def test_one_taxel_resolves_no_angle() -> None:
    x_mm, y_mm = np.zeros_like(WANG.x_mm), np.zeros_like(WANG.y_mm)
    one = WANG.__class__(**{**vars(WANG), "x_mm": x_mm, "y_mm": y_mm})
    none, _ = check_waves(one, JointParams(), 100.0, 60.0)
    assert none.verdict == "warn"
    assert none.words.startswith("no angle (period-only): the period across the motion is 60 mm/s over")


def test_check_config_uses_the_configured_speed_or_any(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "t.toml"
    path.write_text('[port]\nurl = "/dev/none"\n[detect.texture]\nspeed_mm_s = 1.5\n')
    monkeypatch.setattr("sys.argv", ["tactiled", "check-config", str(path)])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code
    valid, port, _, _, grooves, speeds, path_of_scans = capsys.readouterr().err.splitlines()
    assert ("valid" in valid, port) == (True, "port: /dev/none")
    assert grooves.startswith("grooves: wang2019-3x3, at 1.5 mm/s, resolves 0.5 to 15 mm")
    assert speeds.startswith("sliding speed: ")
    assert path_of_scans.startswith("path of a scan: ")
    path.write_text('[port]\nurl = "/dev/none"\n')
    grooves, speeds = resolved_in_words(load_config(path))
    assert grooves.startswith("grooves: wang2019-3x3, at unknown speed, resolves 0.5 to 20 mm")
    assert speeds.startswith("sliding speed: slide across grooves at 22.5 mm/s or slower")
