"""Figures are of what the code computes today."""

from collections.abc import Mapping
from functools import cache
from importlib import import_module

import numpy as np
import pytest

from bench.__main__ import BENCHES
from tools.figures import load_figures

FIGURES = {name: figure for name, figure in load_figures().items() if figure.answers}


@cache
def answers_of(module: str) -> Mapping[str, list[float]]:
    found: Mapping[str, list[float]] = import_module(module).answers()
    return found


def test_benches_whose_results_are_the_same_on_each_host_have_answers() -> None:
    assert {"slip", "grip", "hands", "hold", "texture", "clock"} <= FIGURES.keys()


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_no_older_than_what_it_measures(name: str) -> None:
    """If it fails, results have changed: `./run bench NAME --json docs/figures/NAME.json`."""
    kept, found = FIGURES[name].answers, answers_of(BENCHES[name].answers)
    assert kept is not None
    assert kept.keys() == found.keys()
    for key, values in kept.items():
        # Libraries of other processors round elementary functions otherwise.
        np.testing.assert_allclose(found[key], values, rtol=0.0, atol=1e-5, err_msg=key)
