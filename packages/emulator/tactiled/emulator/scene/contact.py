"""Contact of a scene: prescribed signals, or the mechanics of its plates.

Either computes forces at each channel's own sampling instants, in any chunking and possibly twice, and
returns the same values each time.
"""

from tactiled.array import Array
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.mechanics.periodic import Periodic
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.phases import GroovedPlate
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.prescribed import SignalContact

SceneContact = SignalContact | PhysicalContact


def make_contact(motion: SceneMotion, array: Array) -> SceneContact:
    """Contact of a scene; `ConfigError` where its plates or taxels cannot be played.

    A scene with grooves plays its flat plates on `Periodic`, too: both plates then blend while the skin
    slides from one onto the other.
    """
    if motion.scene.contact == "signal":
        return SignalContact(motion, array)
    is_grooved = any(isinstance(plate, GroovedPlate) for plate in motion.surfaces)
    return PhysicalContact(motion, array, Periodic if is_grooved else Lumped)
