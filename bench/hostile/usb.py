"""USB strings and names that become rules and paths."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
