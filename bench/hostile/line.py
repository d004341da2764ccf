"""Stalls of the host and clocks that are wrong: restarts that never happened."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
