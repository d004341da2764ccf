"""Disks and clocks: recordings that must not be deleted."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
