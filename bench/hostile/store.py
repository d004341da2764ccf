"""Stores of recordings: copies that are damaged."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
