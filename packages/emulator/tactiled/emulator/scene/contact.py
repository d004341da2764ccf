"""Contact models as scenes choose them: from load and travel to the force on every channel's read-out area.

A contact model computes forces at each channel's own sampling instants, in any chunking and possibly
twice, and must return the same values each time. To add a physical one, write a `TaxelModel` in `mechanics`,
and enter it in `TAXEL_MODELS` and in `description.Contact`.
"""

from collections.abc import Sequence

import numpy as np

from tactiled.array import Array
from tactiled.emulator.mechanics.base import TaxelModel
from tactiled.emulator.mechanics.compliance import Compliance
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.mechanics.periodic import Periodic
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.prescribed import SignalContact
from tactiled.emulator.scene.taxels import model_surface
from tactiled.errors import ConfigError

SceneContact = SignalContact | PhysicalContact

TAXEL_MODELS: dict[str, type[TaxelModel]] = {
    "lumped": Lumped,
    "periodic": Periodic,
    "compliance": Compliance,
}
"""Physical contact models, cheapest first. ``signal`` is not among them: its forces are prescribed."""

_NOT_MODELLED = {
    "signal": "mechanics of any kind: the forces are prescribed curves",
    "lumped": "the place of slip within the contact area, grooves, a peak of static friction in slides that "
    "begin faster than stribeck_mm_s",
    "periodic": "grooves during the onset of slip, ripple that lags behind a change of load or direction, "
    "the skin's nonlinearity beyond first order",
    "compliance": "the skin's nonlinearity beyond first order, static friction above sliding, "
    "neighbouring bumps",
}


def make_contact(motion: SceneMotion, array: Array) -> SceneContact:
    """Contact model of a scene; `ConfigError` where none, or not the one that it names, can play it."""
    name = model_name(motion.scene)
    if name == "signal":
        return SignalContact(motion, array)
    return PhysicalContact(motion, array, TAXEL_MODELS[name])


def model_name(scene: Scene) -> str:
    """Name of the contact model that plays a scene; `ConfigError` where there is none."""
    return _choose(scene)[0] if scene.contact == "auto" else scene.contact


def explain(scene: Scene) -> str:
    """Explain in words which contact model plays the scene, why, and what it does not model.

    This holds for simulated time; `prepare.explain_in_real_time` is for a board in real time.

    Raises
    ------
    ConfigError
        No contact model can play the scene, or not the one that the scene names.
    """
    name: str = scene.contact
    if name != "auto":
        if name != "signal" and (reason := _refusal(scene, name)):
            raise ConfigError(f"scene {scene.name}", [reason])
        why = ["named by the scene"]
    else:
        name, rejected = _choose(scene)
        why = [f"not {other}: {reason}" for other, reason in rejected.items()]
        if needs := _needs(scene):
            errors = TAXEL_MODELS[name].provides
            met = ", ".join(f"{need} {100 * errors[need]:.2g} %" for need in needs)
            why = [f"needs within {100 * scene.tolerance:g} %; measured error: {met}", *why]
        else:
            why = ["the scene states no needs: the cheapest that can play it", *why]
    return "\n  ".join([f"contact: {name}", *why, f"not modelled: {_NOT_MODELLED[name]}"])


def _choose(scene: Scene) -> tuple[str, dict[str, str]]:
    """Name of the cheapest contact model whose errors meet every need, and why cheaper ones do not serve."""
    needs = _needs(scene)
    rejected: dict[str, str] = {}
    for name in ("signal", *TAXEL_MODELS):
        if name == "signal":
            refusal = f"cannot play {scene.needs_mechanics}" if scene.needs_mechanics else ""
        else:
            refusal = _refusal(scene, name)
        if not (why := refusal or _shortfall(needs, scene.tolerance, name)):
            return name, rejected
        rejected[name] = why
    faults = [f"needs: {name} does not serve: {why}" for name, why in rejected.items()]
    what = "needs: no contact model delivers this; drop a need or widen tolerance"
    raise ConfigError(f"scene {scene.name}", [*faults, what])


def _needs(scene: Scene) -> Sequence[str]:
    return list(dict.fromkeys(scene.needs))


def _shortfall(needs: Sequence[str], tolerance: float, name: str) -> str:
    """Needs that a contact model does not meet, in words; empty where it meets all."""
    provides = TAXEL_MODELS[name].provides if name in TAXEL_MODELS else {}
    missing = [need for need in needs if need not in provides]
    wide = [need for need in needs if need in provides and provides[need] > tolerance]
    parts = [f"does not model {', '.join(missing)}"] if missing else []
    parts += [f"{need} is {100 * provides[need]:.2g} % off" for need in wide]
    return "; ".join(parts)


def _refusal(scene: Scene, name: str) -> str:
    """Reason why a contact model cannot be built for the plates of a scene; empty where it can."""
    try:
        for plate in SceneMotion(scene).surfaces:
            TAXEL_MODELS[name](model_surface(plate), np.zeros(1), 1)
    except ConfigError as error:
        return "; ".join(error.faults)
    return ""
