"""Picture of the first slip: the lead time that it states is that of the events."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from messages import SLIP

from tactiled.demo.first_slip import draw_first_slip
from tactiled.events.types import GripEvent
from tactiled.plots.log import KnownTruth

TIME_S = np.arange(100) / 100
TRUTH = KnownTruth((0.35,), ((0.3, 0.5),), TIME_S, np.clip((TIME_S - 0.3) / 0.2, 0, 1))
GRIPS = [GripEvent(time_s=t, utilisation=0.4, state="sticking", valid=True) for t in TIME_S]


@pytest.mark.parametrize(
    ("detected_s", "title"),
    [
        ((0.1, 0.38, 0.45), "Slip is reported 120 ms before all of the contact slides"),
        ((0.1, 0.55), "No slip was reported before all of the contact slid"),
        ((), "No slip was reported before all of the contact slid"),
    ],
)
def test_the_lead_is_from_the_first_report_after_shear_began(
    tmp_path: Path, detected_s: tuple[float, ...], title: str
) -> None:
    slips = [replace(SLIP, detected_s=at_s) for at_s in detected_s]
    out = tmp_path / "a.png"
    assert draw_first_slip(out, [*GRIPS, *slips], TRUTH) == title
    assert out.stat().st_size > 10_000
    assert draw_first_slip(out, slips, TRUTH) == title  # without a contact that was estimated
