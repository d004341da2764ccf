"""Picture of the slips: the lead time that it states is that of the events."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from messages import SLIP

from tactiled.demo.slip_picture import draw_slips
from tactiled.events.types import GripEvent
from tactiled.plots.log import KnownTruth

TIME_S = np.arange(200) / 100
USED = np.clip((TIME_S % 1.0 - 0.3) / 0.2, 0, 1)
TRUTH = KnownTruth((0.35, 1.35), ((0.3, 0.5), (1.3, 1.5)), TIME_S, USED)
GRIPS = [GripEvent(time_s=t, utilisation=0.4, state="sticking", valid=True) for t in TIME_S]


@pytest.mark.parametrize(
    ("detected_s", "title"),
    [
        ((0.1, 0.38, 0.45, 1.4), "Slip is reported 120 ms and 100 ms before all of the contact slides"),
        ((0.1, 0.55, 1.4), "Slip is reported 100 ms before all of the contact slides, 1 of 2 times"),
        ((0.1, 0.55, 1.6), "No slip was reported before all of the contact slid"),
        ((), "No slip was reported before all of the contact slid"),
    ],
)
def test_the_lead_is_from_the_first_report_after_shear_began(
    tmp_path: Path, detected_s: tuple[float, ...], title: str
) -> None:
    slips = [replace(SLIP, detected_s=at_s) for at_s in detected_s]
    out = tmp_path / "a.png"
    assert draw_slips(out, [*GRIPS, *slips], TRUTH) == title
    assert out.stat().st_size > 10_000
    assert draw_slips(out, slips, TRUTH) == title  # without a contact that was estimated
