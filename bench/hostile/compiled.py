"""Arrays of any size through the compiled path, on a small stack."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
