"""Subscribers that subscribe without end, stall or leave."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
