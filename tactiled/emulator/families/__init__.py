"""Randomised scenes: each family is a function of a seed, the same seed the same scene on any machine.

``SLIPPING`` is what a detector must find, ``QUIET`` what it must not mistake for it; `FAMILIES` has both.
"""

from collections.abc import Callable

from tactiled.emulator.families import quiet, slipping
from tactiled.emulator.scene import Scene

Family = Callable[[int], Scene]

SLIPPING: dict[str, Family] = {
    "steady-slide": slipping.steady_slide,
    "accelerating-slide": slipping.accelerating_slide,
    "reversing-slide": slipping.reversing_slide,
    "stick-slip": slipping.stick_slip,
    "creep-into-slip": slipping.creep_into_slip,
    "jerk-into-slip": slipping.jerk_into_slip,
    "turning": slipping.turning,
    "partial-contact": slipping.partial_contact,
    "grooves": slipping.grooves,
}
QUIET: dict[str, Family] = {
    "taps": quiet.taps,
    "grip-changes": quiet.grip_changes,
    "motor-hum": quiet.motor_hum,
    "arm-acceleration": quiet.arm_acceleration,
    "cable-tug": quiet.cable_tug,
    "load-and-back": quiet.load_and_back,
    "inclined-load": quiet.inclined_load,
    "thermal-drift": quiet.thermal_drift,
    "persistent-contact": quiet.persistent_contact,
}
FAMILIES: dict[str, Family] = SLIPPING | QUIET
