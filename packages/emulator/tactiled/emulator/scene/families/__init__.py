"""Random scenes: each family is a function of a seed, with the same scenes on any machine.

A detector must report the slips in ``SLIPPING`` and none in ``QUIET``. Families in ``HELD_OUT_`` are for
reports only: nothing may be tuned on them. Whether an object in ``HELD`` slips is up to the controller of its
gripper. `FAMILIES` has all.
"""

from collections.abc import Callable

from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.families import held_out, holding, quiet, slipping

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
HELD_OUT_SLIPPING: dict[str, Family] = {
    "braking-drag": held_out.braking_drag,
    "swelling-pull": held_out.swelling_pull,
    "changing-grip": held_out.slide_under_changing_grip,
    "slip-on-shear": held_out.slip_on_shear,
}
HELD_OUT_QUIET: dict[str, Family] = {
    "walking": held_out.walking,
    "hand-over": held_out.hand_over,
    "off-centre-squeeze": held_out.off_centre_squeeze,
}
HELD: dict[str, Family] = {"hold": holding.hold}
FAMILIES: dict[str, Family] = SLIPPING | QUIET | HELD_OUT_SLIPPING | HELD_OUT_QUIET | HELD
