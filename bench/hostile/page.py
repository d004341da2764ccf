"""The live page: idle sockets, long paths, odd messages."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
