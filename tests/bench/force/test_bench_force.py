"""Scores of the force bench against what is known of them."""

from dataclasses import replace

import numpy as np
import pytest

from bench.force.bench import AIMS, MAIN, SHORT, ForceFound, pooled
from bench.force.score import METHODS, ForceScore, HoldScore, score


@pytest.fixture(scope="module")
def scored() -> ForceScore:
    return score(20_000, SHORT)


def test_a_score_has_every_method(scored: ForceScore) -> None:
    assert set(scored.normal) == set(scored.shear) == set(METHODS)
    assert scored.normal["tactiled"] < scored.normal["linear map"] < scored.normal["published"]
    assert scored.late_error_s < 0.01


def test_the_same_seed_gives_the_same_score(scored: ForceScore) -> None:
    again = score(20_000, SHORT)
    assert again.normal["tactiled"] == pytest.approx(scored.normal["tactiled"], rel=1e-6)


def test_aims_read_what_was_measured(scored: ForceScore) -> None:
    good = replace(scored, case=MAIN, inside=(0.9, 0.9, 0.9), centre_mm=0.1)
    good = replace(
        good, normal={**scored.normal, "tactiled": 0.003}, shear={**scored.shear, "tactiled": 0.002}
    )
    bad = replace(good, inside=(0.5, 0.9, 0.9), centre_mm=0.5)
    hold = HoldScore(1, 0.9, 1.0, 0.1, 0.2)
    verdicts = {}
    for name, one in (("good", good), ("bad", bad)):
        found = ForceFound([one], [hold], 30.0, 90.0)
        verdicts[name] = {aim.name: aim.measure(found).verdict for aim in AIMS}
    assert verdicts["good"]["90 % intervals hold"] == "met"
    assert verdicts["bad"]["90 % intervals hold"] == "MISSED"
    assert verdicts["good"]["centre of pressure above 1 N"] == "met"
    assert verdicts["bad"]["centre of pressure above 1 N"] == "MISSED"
    assert verdicts["good"]["worse than ridge with squares by 1 % or more"] == "met"


def test_rms_errors_are_pooled_over_rigs(scored: ForceScore) -> None:
    other = replace(scored, normal={**scored.normal, "tactiled": 3 * scored.normal["tactiled"]})
    one = scored.normal["tactiled"]
    assert pooled([scored, other], "normal", "tactiled") == pytest.approx(one * np.sqrt(5))
