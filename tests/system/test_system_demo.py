"""`tactiled demo` as a newcomer runs it: three processes, truth beside estimate, a picture."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.system


def test_demo_is_right_and_in_time(tmp_path: Path) -> None:
    began_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "tactiled", "demo"],
        capture_output=True, text=True, cwd=tmp_path, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert time.monotonic() - began_s < 60  # the scene itself takes 30
    assert "WRONG" not in done.stdout
    for quantity in ("incipient at", "gross at", "direction", "answer after", "period", "angle"):
        assert f"grooves: {quantity}" in done.stdout
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


def test_an_estimate_that_is_wrong_is_called_so() -> None:
    """The verdict can fail: a texture beyond the published errors, a direction turned round, a third slip."""
    import dataclasses

    from tactiled.demo.verdict import Seen, compare
    from tactiled.events.types import SlipEvent, TextureEvent

    surface = {"kind": "grooves", "period_mm": 1.2, "angle_deg": 30.0}
    scene = {"t0_s": 0.0}
    true = {"incipient_s": 5.0, "gross_s": 5.2, "end_s": 9.0, "direction_deg": 0.0, "surface": surface}
    lift = true | {"incipient_s": 9.0, "direction_deg": None}  # goes nowhere: nothing to find
    slips = {0: true, 1: lift}
    begun = SlipEvent(
        time_s=4.99, state="onset", kind="incipient", onset_s=4.99, onset_sd_s=0.02, direction_deg=1.0,
        direction_sd_deg=1.0, confidence=1.0, taxels=(0,), detector="x", statistic=1.0, threshold=1.0,
        valid=True, detected_s=5.05,
    )  # fmt: skip
    slip = dataclasses.replace(begun, kind="gross", onset_s=5.21, detected_s=5.25)
    texture = TextureEvent(time_s=8.0, status="ok", period_mm=1.202, angle_deg=30.1)
    assert compare(Seen(scene, slips, events=[begun, slip, texture]))[1]
    for wrong in (
        [begun, slip],
        [texture],
        [begun, texture],
        [slip, texture],
        [begun, slip, slip, texture],
        [begun, dataclasses.replace(slip, direction_deg=180.0), texture],
        [begun, dataclasses.replace(slip, onset_s=5.3), texture],
        [begun, slip, dataclasses.replace(texture, period_mm=1.22)],
        [begun, slip, dataclasses.replace(texture, angle_deg=29.0)],
        [begun, slip, dataclasses.replace(texture, time_s=8.5)],
    ):
        assert not compare(Seen(scene, slips, events=list(wrong)))[1]
