"""Configuration files that no parser expects."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
