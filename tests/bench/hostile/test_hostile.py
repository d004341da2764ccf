"""The short form of every attack of ``./run bench hostile``."""

import pytest
from zenoh_threads import zenoh_threads

from bench.hostile.attack import Attack
from bench.hostile.bench import all_attacks, do

__all__ = ["zenoh_threads"]  # a fixture for every test here

SHORT = [attack for attack in all_attacks() if attack.short is not None]


@pytest.mark.parametrize("attack", SHORT, ids=[attack.name for attack in SHORT])
def test_every_border_holds(attack: Attack) -> None:
    assert attack.short is not None
    outcome = do(attack, attack.short)
    assert outcome.held, f"tried: {attack.tried}; expected: {attack.expected}; seen: {outcome.seen}"
