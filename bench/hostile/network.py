"""Networks of robots: ROS 2, zenoh, fleets."""

from bench.hostile.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
