"""Files of others: sizes that lie, tables that expand."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
