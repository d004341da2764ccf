"""Directions of slips, against the emulator's truth."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from touches import onsets

from tactiled.array import load_array
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.scene.description import Scene
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.tomlfile import parse
from tactiled.wang2019.slip import WaveletSlip

WANG = load_array("wang2019-3x3")
PRESS = {"kind": "press", "duration_s": 2.0, "force_n": 20.0}
HOLD = {"kind": "hold", "duration_s": 2.0}
FLAT = {"kind": "flat"}


def slide(duration_s: float, speed_mm_s: float, direction_deg: float) -> dict[str, Any]:
    return {
        "kind": "slide",
        "duration_s": duration_s,
        "speed_mm_s": speed_mm_s,
        "direction_deg": direction_deg,
    }


def felt(phases: Sequence[dict[str, Any]], *, seed: int) -> ScanBlock:
    """Readings of a scene, with channels sampled 0.2 ms apart."""
    document = {"name": "slide", "array": WANG.name, "seed": seed, "surface": FLAT}
    scene = parse(document | {"electronics": {"noise_v": 0.3e-3}, "phases": list(phases)}, Scene, "test")
    offsets_s = np.arange(float(WANG.n_channels)) * 200e-6
    time_s = np.arange(round(scene.duration_s * 100))[:, np.newaxis] / 100 + offsets_s
    counts = Sensor(scene, WANG, adc_bits=12, adc_reference_v=3.0).counts(0, time_s)
    return regular_block(counts * 3.0 / 4096, 100.0, channel_offset_s=offsets_s, valid=counts < 4095)


def off_deg(angle_deg: float, truth_deg: float) -> float:
    return (angle_deg - truth_deg + 180) % 360 - 180


def test_the_stated_sd_covers_any_direction_at_any_speed() -> None:
    """Unequal taxels and a saturating divider, at directions without symmetry."""
    rng = np.random.default_rng(11)
    z = []
    for seed, speed_mm_s in enumerate([0.25, 1.0, 5.0, 20.0] * 6):
        direction_deg = float(rng.uniform(-180, 180))
        (onset,) = onsets(
            WaveletSlip(WANG).process(
                felt([PRESS, HOLD, slide(0.5, speed_mm_s, direction_deg)], seed=seed + 1)
            )
        )
        z.append(off_deg(onset.direction_deg, direction_deg) / onset.direction_sd_deg)
    assert np.abs(z).max() < 3


def test_one_taxel_has_a_direction() -> None:
    volts = felt([PRESS, HOLD, slide(0.5, 1.0, 20.0)], seed=1).volts.copy()
    volts[:, 4:] = np.nan
    (one,) = onsets(WaveletSlip(WANG).process(regular_block(volts, 100.0)))
    assert abs(off_deg(one.direction_deg, 20.0)) <= 3 * one.direction_sd_deg
