"""Pictures of groove estimates: events over time, map of the array, text."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from slips import slip_at

from tactiled.array import load_array
from tactiled.events.types import Candidate, TextureEvent
from tactiled.plots.grooves import answer_in_words, draw_answers, draw_map

ARRAY = load_array("wang2019-3x3")


def test_a_log_shows_answers_and_refusals() -> None:
    events = [
        TextureEvent(time_s=1.0, answered_s=1.0, status="too-few-periods"),
        TextureEvent(
            time_s=2.0, answered_s=2.0, status="ok", period_mm=1.2, period_sd_mm=0.001, angle_deg=30.0
        ),
        TextureEvent(
            time_s=3.0, answered_s=3.0, status="ok", period_mm=1.21, period_sd_mm=0.0004, angle_deg=30.1
        ),
    ]
    axes = Figure().subplots(1, 2)
    draw_answers(axes[0], axes[1], events, 1.0)
    line, refused = axes[0].lines[0], axes[0].lines[-1]
    np.testing.assert_array_equal(line.get_xydata(), [[1.0, 1.2], [2.0, 1.21]])
    assert refused.get_xdata() == [0.0]
    assert "1.2100 ± 0.0004" in axes[0].get_title()


ANSWER = TextureEvent(time_s=1.99, answered_s=1.99, status="ok", period_mm=1.2, angle_deg=30.0, window_s=2.0)


def test_map_has_grooves_taxels_and_motion() -> None:
    axis = Figure().subplots()
    second = tuple(
        Candidate(period_mm=mm, angle_deg=deg, weight=0.5) for mm, deg in ((1.2, 30.0), (2.0, -20.0))
    )
    draw_map(axis, ARRAY, replace(ANSWER, candidates=second), [slip_at(0.0, 10.0)])
    assert len(axis.patches) == 9
    groove = np.asarray(axis.lines[0].get_xydata())
    along = groove[1] - groove[0]
    assert abs(along @ [np.cos(np.radians(30)), np.sin(np.radians(30))]) < 1e-9
    legend = axis.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [
        "second: 2 mm, -20.0°",
        "direction of slip 10°",
    ]


def test_the_answer_in_words() -> None:
    refused = TextureEvent(time_s=1.0, answered_s=1.0, status="ambiguous")
    assert answer_in_words([], []) == ""
    assert answer_in_words([refused, refused], []) == "grooves: no answer (ambiguous 2)"
    period_only = replace(refused, status="period-only", period_mm=1.2, period_sd_mm=0.01, estimator="lines")
    assert answer_in_words([refused, period_only], []) == "grooves of 1.200 ± 0.010 mm, angle unknown (lines)"
    told = replace(ANSWER, period_sd_mm=0.001, angle_sd_deg=0.1, estimator="joint")
    both = tuple(Candidate(period_mm=mm, angle_deg=30.0, weight=0.5) for mm in (1.2, 2.5))
    assert "; another of 2.5 mm at 30.0°" in answer_in_words([replace(told, candidates=both)], [])
    assert answer_in_words([refused, told], [slip_at(0.5, 0.0)]) == (
        "grooves of 1.2000 ± 0.0010 mm at 30.00 ± 0.10° (joint; first answer 1.5 s after slip was detected)"
    )
