"""Spoiled windows are spoiled as they say; what is drawn of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from bench.pool import workers
from bench.texture.bound import Wave, turns
from bench.texture.curve import TIMES_S, Slide, curve_table, points, slide
from bench.texture.grid import Trial
from bench.texture.misfit import Spoiled, misfit_table, spoiled
from bench.texture.online import answers, slip_at
from bench.texture.paper import Answered
from bench.texture.picture import draw_texture
from bench.texture.plates import GROOVELESS, LSB_VOLTS, MISFITS
from bench.texture.signal import sensed_by, wave_volts
from bench.texture.window import Window, perfect
from tactiled.array import load_array
from tactiled.detect.grooves.estimator import JointParams
from tactiled.events.types import Candidate, TextureEvent
from tactiled.plots.grooves import answer_in_words, draw_answers, draw_folded, draw_map, in_words

ARRAY = load_array("wang2019-3x3")


def window(name: str, seed: int = 0) -> tuple[Window, np.random.Generator]:
    rng = np.random.default_rng(seed)
    made = perfect(ARRAY, rng, 2.0)
    (MISFITS | GROOVELESS)[name](made, rng)
    return made, rng


@pytest.mark.parametrize("name", sorted(MISFITS | GROOVELESS))
def test_readings_are_within_the_converters_range(name: str) -> None:
    made, rng = window(name)
    volts = made.volts(rng)
    assert volts.shape == (200, 36)
    assert np.isfinite(volts).all()
    assert volts.min() >= 0
    assert volts.max() <= 3


def test_perfect_window_is_the_wave_of_the_bound() -> None:
    made, rng = window("none")
    ripple = made.volts(rng) - made.level_volts
    # The same wave up to where its phases count from.
    middle = turns(made.wave, made.sensed, np.array([made.time_s.mean()])).mean()
    assert abs(middle) < 10
    expected = wave_volts(made.wave, made.sensed, made.time_s - made.time_s.mean())
    assert np.std(ripple - expected, axis=0) == pytest.approx(made.sensed.noise_volts, rel=0.25)


def test_speeds_that_are_told_are_those_of_the_travel() -> None:
    made, _ = window("the same, told each 0.1 s")
    speeds = np.repeat([speed for _, speed in made.given_mm_s], 10)
    true = np.diff(made.travel_mm[:, 0]) * 100
    assert np.abs(speeds[:-1] - true).max() < 0.05 * 1.5
    assert speeds[:-1].sum() / 100 == pytest.approx(made.travel_mm[-1, 0] - made.travel_mm[0, 0], rel=1e-4)


def test_windows_without_grooves_have_none() -> None:
    made, rng = window("flat plate")
    assert np.std(made.volts(rng), axis=0) == pytest.approx(made.sensed.noise_volts, rel=0.25)
    made, rng = window("ripple of one converter step")
    assert np.ptp(made.volts(rng) - made.level_volts, axis=0).min() > LSB_VOLTS
    made, _ = window("sand paper, grain 0.3 mm")
    assert (made.sensed.amplitude_volts == 0).all()
    # Taxels of a row see the same strip, each later by its place: not the same thing at one instant.
    at_once = np.abs(np.asarray(np.corrcoef(made.added_volts[:, ::4].T)))
    assert at_once[~np.eye(9, dtype=np.bool_)].mean() < 0.5


def test_an_answer_without_grooves_is_wrong() -> None:
    found = spoiled("flat plate", True, 0)
    assert found.status != "ok"
    assert not found.is_wrong
    clean = spoiled("none", True, 0)
    assert clean.status == "ok"
    assert not clean.is_wrong
    assert abs(clean.period_error_mm) < 6 * clean.period_sd_mm


def test_table_of_misfits() -> None:
    rows = [
        Spoiled("x", True, 0, "ok", 0.001, 0.001, 0.1, 0.04),
        Spoiled("x", True, 1, "ok", 9.0, 0.001, 9.0, 0.04, True),
        Spoiled("x", False, 0, "ambiguous"),
    ]
    assert "| 2 of 2                | 1     | 1 um, 0.1 deg   | 100 %, 0 %" in misfit_table(rows)
    assert "ambiguous 1" in misfit_table(rows)


def test_answers_do_not_depend_on_blocks() -> None:
    made, rng = window("none")
    volts, slip = made.volts(rng), slip_at(0.0, 0.0)
    params = JointParams(max_window_s=1.5)
    said = [
        list(answers(ARRAY, params, volts, made.sensed.offset_s, slip, given_mm_s=[(0, 1.5)], block_scans=n))
        for n in (7, 200)
    ]
    assert said[0] == said[1]
    assert said[0]


def a_slide() -> Slide:
    n = len(TIMES_S)
    nothing = (float("nan"),) * 3
    return Slide(
        "quick", 0, 2.0, 1e-3, 0.1,
        period_error_mm=nothing + (1e-3,) * (n - 3),
        angle_error_deg=nothing + (0.1,) * (n - 3),
        period_bound_mm=(5e-4,) * n,
        angle_bound_deg=(0.05,) * n,
    )  # fmt: skip


def test_curve_of_slides() -> None:
    curve = points([a_slide(), a_slide()])
    assert [p.answered for p in curve[:4]] == [0, 0, 0, 2]
    assert curve[3].period_mm == pytest.approx(1e-3)
    assert curve[0].period_bound_mm == pytest.approx(5e-4)


def test_slides_are_answered_near_the_bound() -> None:
    found = slide("quick", 0)
    assert np.isfinite(found.first_s)
    assert abs(found.period_error_mm[-1]) < 5 * found.period_bound_mm[-1]
    assert abs(found.angle_error_deg[-1]) < 5 * found.angle_bound_deg[-1]
    presets = [Slide(**vars(found) | {"preset": preset}) for preset in ("quick", "balanced", "fine")]
    assert f"{found.first_s:.1f} s" in curve_table(presets)


def test_pictures_are_written(tmp_path: Path) -> None:
    trials = [
        Trial(window_s, snr_db, known, 0, 5.0, 1.2, 30.0, "ok", 1.0, 1.0, 1.0, 1.0)
        for window_s in (1.0, 2.0)
        for snr_db in (0.0, 20.0)
        for known in (True, False)
    ]
    plates = [Answered((1.2, 30), "procedure", 1, [(1.21, 31.0)]), Answered((1.2, 30), "joint, 2 s", 1, [])]
    draw_texture(tmp_path / "texture.png", trials, plates, [a_slide()])
    assert (tmp_path / "texture.png").stat().st_size > 1000


def test_a_log_shows_answers_and_refusals() -> None:
    events = [
        TextureEvent(time_s=1.0, status="too-few-periods"),
        TextureEvent(time_s=2.0, status="ok", period_mm=1.2, period_sd_mm=0.001, angle_deg=30.0),
        TextureEvent(time_s=3.0, status="ok", period_mm=1.21, period_sd_mm=0.0004, angle_deg=30.1),
    ]
    axes = Figure().subplots(1, 2)
    draw_answers(axes[0], axes[1], events, 1.0)
    line, refused = axes[0].lines[0], axes[0].lines[-1]
    np.testing.assert_array_equal(line.get_xydata(), [[1.0, 1.2], [2.0, 1.21]])
    assert refused.get_xdata() == [0.0]
    assert "1.2100 ± 0.0004" in axes[0].get_title()


def a_ripple(angle_deg: float, direction_deg: float) -> tuple[np.ndarray, np.ndarray, TextureEvent]:
    """Two seconds over grooves of 1.2 mm at 2 mm/s: instants, volts, and the right answer."""
    sensed = sensed_by(ARRAY, np.random.default_rng(0), 30.0, ())
    wave, time_s = Wave(1.2, angle_deg, 2.0, direction_deg), np.arange(200) / 100
    hz = abs(wave.frequency_hz)
    event = TextureEvent(
        time_s=1.99, status="ok", period_mm=1.2, angle_deg=angle_deg, frequency_hz=hz, window_s=2.0
    )
    return time_s, 1.0 + wave_volts(wave, sensed, time_s), event


@pytest.mark.parametrize(("angle_deg", "direction_deg"), [(30.0, 0.0), (30.0, 180.0), (-60.0, -20.0)])
def test_ripples_fold_to_one_where_the_grooves_are_right(angle_deg: float, direction_deg: float) -> None:
    time_s, volts, event = a_ripple(angle_deg, direction_deg)
    offset_s, slip = 1e-4 * np.arange(36, dtype=np.float64), slip_at(0.0, direction_deg)
    spreads = []
    for shown in (event, replace(event, angle_deg=angle_deg + 10)):
        axis = Figure().subplots()
        draw_folded(axis, ARRAY, time_s, volts, offset_s, shown, [slip])
        phases = np.linspace(0.05, 0.95, 30)
        curves = [np.interp(phases, *np.asarray(line.get_xydata()).T) for line in axis.lines]
        assert len(curves) == 9
        spreads.append(float(np.std(curves, axis=0).mean()))
    assert spreads[0] < 2.0  # mV of 20: a cubic takes a little, and bins are as wide as a scan
    assert spreads[1] > 4.0


def test_map_has_grooves_taxels_and_motion() -> None:
    _, _, event = a_ripple(30.0, 0.0)
    axis = Figure().subplots()
    second = tuple(
        Candidate(period_mm=mm, angle_deg=deg, weight=0.5) for mm, deg in ((1.2, 30.0), (2.0, -20.0))
    )
    draw_map(axis, ARRAY, replace(event, candidates=second), [slip_at(0.0, 10.0)])
    assert len(axis.patches) == 9
    groove = np.asarray(axis.lines[0].get_xydata())
    along = groove[1] - groove[0]
    assert abs(along @ [np.cos(np.radians(30)), np.sin(np.radians(30))]) < 1e-9
    legend = axis.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [
        "second: 2 mm, -20.0°",
        "the skin goes to 10°",
    ]


def test_the_answer_in_words() -> None:
    _, _, event = a_ripple(30.0, 0.0)
    refused = TextureEvent(time_s=1.0, status="ambiguous")
    assert answer_in_words([], []) == ""
    assert answer_in_words([refused, refused], []) == "grooves: no answer (ambiguous 2)"
    told = replace(event, period_sd_mm=0.001, angle_sd_deg=0.1, estimator="joint")
    both = tuple(Candidate(period_mm=mm, angle_deg=30.0, weight=0.5) for mm in (1.2, 2.5))
    assert "; another of 2.5 mm at 30.0°" in answer_in_words([replace(told, candidates=both)], [])
    assert answer_in_words([refused, told], [slip_at(0.5, 0.0)]) == (
        "grooves of 1.200 ± 0.001 mm at 30.0 ± 0.1° (joint; first answer 1.5 s after slip was said)"
    )


@pytest.mark.parametrize(
    ("sd", "words"), [(0.0012, "1.235 ± 0.001"), (2.0, "1 ± 2"), (0.0, "1.234567890 ± 0.000000000")]
)
def test_digits_are_those_of_the_sigma(sd: float, words: str) -> None:
    assert in_words(1.23456789, sd) == words


def test_workers_give_results_in_order() -> None:
    with workers() as pool:
        assert list(pool.map(abs, [-1, 2])) == [1, 2]
