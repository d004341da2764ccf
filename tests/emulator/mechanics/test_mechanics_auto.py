"""The cheapest model that serves, or a refusal that says why."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.emulator.mechanics.auto import ModelOption, choose
from tactiled.errors import ConfigError

NEEDS = ["direction", "left-right", "groove-ripple", "transients"]
ladder = st.lists(
    st.builds(
        ModelOption,
        name=st.text("abcdefgh", min_size=1, max_size=3),
        provides=st.dictionaries(st.sampled_from(NEEDS), st.floats(0, 1)),
        refusal=st.sampled_from(["", "", "grooves"]),
    ),
    max_size=5,
    unique_by=lambda candidate: candidate.name,
)


@given(ladder, st.lists(st.sampled_from(NEEDS), max_size=4), st.floats(0, 1))
def test_the_first_candidate_that_meets_every_need_is_chosen(
    candidates: list[ModelOption], needs: list[str], tolerance: float
) -> None:
    serves = [
        c.name
        for c in candidates
        if not c.refusal and all(need in c.provides and c.provides[need] <= tolerance for need in needs)
    ]
    if not serves:
        with pytest.raises(ConfigError) as caught:
            choose("scene s", needs, tolerance, candidates)
        assert all(f"needs: {c.name} does not serve" in str(caught.value) for c in candidates)
        return
    choice = choose("scene s", needs, tolerance, candidates)
    assert choice.name == serves[0]
    assert list(choice.rejected) == [c.name for c in candidates][: len(choice.rejected)]
    assert all(error <= tolerance for error in choice.errors.values())


def test_a_choice_explains_its_reasons() -> None:
    ladder = [
        ModelOption("lumped", {"direction": 0.01}, refusal="lumped cannot play grooves"),
        ModelOption("periodic", {"direction": 0.01, "groove-ripple": 0.3}),
        ModelOption("compliance", {"direction": 0.01, "groove-ripple": 0.08}),
    ]
    text = choose("scene s", ["direction", "groove-ripple"], 0.1, ladder).explain()
    assert text.splitlines()[0] == "contact: compliance"
    assert "not lumped: lumped cannot play grooves" in text
    assert "not periodic: groove-ripple is 30 % off" in text
    assert "not modelled: the skin's nonlinearity" in text
    assert "states no needs" in choose("scene s", [], 0.1, ladder).explain()


def test_needs_that_no_contact_model_meets_are_refused() -> None:
    ladder = [ModelOption("lumped", {"direction": 0.01}), ModelOption("periodic", {"groove-phase": 0.2})]
    with pytest.raises(ConfigError) as caught:
        choose("scene s", ["groove-phase"], 0.1, ladder)
    assert "lumped does not serve: does not model groove-phase" in str(caught.value)
    assert "periodic does not serve: groove-phase is 20 % off" in str(caught.value)
