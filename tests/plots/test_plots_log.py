"""Picture of a whole log: slip spans, the margin, the first slip."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tactiled.array import FloatArray, load_array
from tactiled.events.types import GripEvent, SlipEvent, TextureEvent
from tactiled.plots import log as log_module
from tactiled.plots.log import KnownTruth, draw_log

ARRAY = load_array("wang2019-3x3")
TIME_S = np.arange(400) / 100
ONSET = SlipEvent(
    time_s=2.0, state="onset", kind="incipient", onset_s=2.0, onset_sd_s=0.002, direction_deg=0.0,
    direction_sd_deg=5.0, confidence=1.0, taxels=(4,), detector="test", statistic=2.0, threshold=1.0,
    valid=True, detected_s=2.02,
)  # fmt: skip


def sheared(growth: float) -> FloatArray:
    """Constant pressure of 1 V; the shear over pressure along x grows by `growth` from 2 s to 3.28 s."""
    ramp = growth * np.clip((TIME_S - 2.0) / 1.28, 0, 1)
    volts = np.ones((len(TIME_S), ARRAY.n_channels))
    names = np.array([name.split(".")[-1] for name in ARRAY.channel_name])
    volts[:, names == "R1"] += ramp[:, np.newaxis] / 2
    volts[:, names == "R3"] -= ramp[:, np.newaxis] / 2
    return volts


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures that are drawn."""
    found: list[Figure] = []

    def kept(*args: Any, **options: Any) -> Figure:
        found.append(Figure(*args, **options))
        return found[-1]

    monkeypatch.setattr(log_module, "Figure", kept)
    return found


def test_a_log_with_refused_grooves_shows_slips_and_the_reason(tmp_path: Path, figures: list[Figure]) -> None:
    end = replace(ONSET, state="end", time_s=3.0, detected_s=3.0)
    refusal = TextureEvent(time_s=3.9, answered_s=3.9, status="low-snr")
    out = tmp_path / "a.png"
    draw_log(out, ARRAY, TIME_S, sheared(0.3), [ONSET, end, refusal], "a")
    assert out.stat().st_size > 10_000
    assert figures[0].get_suptitle().endswith("\ngrooves: no answer (low-snr 1)")
    assert [axis.get_title() for axis in figures[0].axes] == ["", "first incipient slip"]
    legend = figures[0].axes[0].get_legend()
    assert legend is not None
    assert {text.get_text() for text in legend.get_texts()} >= {"incipient slip", "onset to detection"}
    for axis in figures[0].axes:
        assert len(axis.lines) <= 5 + 3  # channels, and marks of one slip


def test_the_taxel_that_moves_most_is_drawn_whatever_is_missing(
    tmp_path: Path, figures: list[Figure]
) -> None:
    volts = 5.0 + sheared(0.3)
    volts[:, 8:] = 6.0
    volts[::10, 12:16] = np.nan
    draw_log(tmp_path / "a.png", ARRAY, TIME_S, volts, [], "a")
    assert figures[0].get_suptitle().startswith("a: taxel 0 of")


def test_a_slip_without_a_scan_near_its_onset_is_drawn(tmp_path: Path, figures: list[Figure]) -> None:
    onset = replace(ONSET, kind="gross", time_s=2.25, onset_s=2.25, detected_s=3.0)
    draw_log(tmp_path / "a.png", ARRAY, TIME_S[::50], sheared(0.3)[::50], [onset], "a")
    assert [axis.get_title() for axis in figures[0].axes] == ["", "first gross slip"]


def test_a_log_with_margins_has_a_row_for_them_and_for_the_truth(
    tmp_path: Path, figures: list[Figure]
) -> None:
    grips = [
        GripEvent(time_s=t, utilisation=0.4, state="sticking" if t > 1 else "none", valid=True)
        for t in TIME_S
    ]
    truth = KnownTruth((), (), TIME_S, np.full(len(TIME_S), 0.5))
    draw_log(tmp_path / "a.png", ARRAY, TIME_S, sheared(0.3), grips, "a", truth=truth)
    (axis,) = (a for a in figures[0].axes if a.get_ylabel() == "shear over\nfriction limit")
    lines = {line.get_label(): np.asarray(line.get_ydata(), float) for line in axis.lines}
    assert set(lines["true"]) == {0.5}
    assert np.isnan(lines["utilisation"][TIME_S <= 1]).all()
    assert set(lines["utilisation"][TIME_S > 1]) == {0.4}
