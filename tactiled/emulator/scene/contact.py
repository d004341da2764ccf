"""The seam between a scene and the sensor: forces on the read-out area of every channel.

A contact model is one rung of a ladder. It is asked for forces at each channel's own sampling instants,
in any chunking and possibly twice, and must answer the same each time. Add a physical rung by a class in
`mechanics`, an entry in `RUNGS` and its name in `scene.Contact`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics import compliance, lumped, periodic
from tactiled.emulator.mechanics.auto import NOT_MODELLED, RungChoice, RungOption, choose
from tactiled.emulator.mechanics.base import Rung, Surface
from tactiled.emulator.mechanics.sides import Readout
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.imposed import Build
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import ContactState, PhysicalContact
from tactiled.emulator.scene.prescribed import SignalContact
from tactiled.emulator.scene.taxels import rung_surface
from tactiled.errors import ConfigError


class ContactModel(Protocol):
    """A rung: what the skin's contact with the surface does to the sensor."""

    def forces(self, time_s: FloatArray) -> FloatArray:
        """Newtons on each channel's read-out area.

        Parameters
        ----------
        time_s : (n, channels) float64
            Scene time at which each channel of n scans is sampled.

        Returns
        -------
        (n, channels) float64
            Normal force for ``side`` and ``normal`` channels (0 or more), signed tangential force of
            the taxel for ``shear_x`` and ``shear_y``.
        """
        ...

    def state(self, time_s: FloatArray) -> ContactState:
        """Truth at instants (n,) of scene time."""
        ...

    def relaxed_load_n(self, time_s: FloatArray) -> FloatArray:
        """Total load through the lag of the scene's creep, at instants (n, channels)."""
        ...

    def load_and_peak_n(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Total load and the largest that it was since contact, at instants (n, channels)."""
        ...


def make_contact(motion: SceneMotion, array: Array) -> ContactModel:
    """Contact model that the scene asks for.

    Raises
    ------
    ConfigError
        No rung, or not the one that the scene names, can play it; says why.
    """
    scene = motion.scene
    name = choose_rung(scene).rung if scene.contact == "auto" else scene.contact
    if name == "signal":
        return SignalContact(motion, array)
    return PhysicalContact(motion, array, _builder(scene, name), RUNGS[name].step_s, name)


def choose_rung(scene: Scene) -> RungChoice:
    """What ``auto`` makes of a scene: the cheapest rung that meets its needs, and why.

    Raises
    ------
    ConfigError
        None does.
    """
    reason = scene.needs_mechanics
    candidates = [RungOption("signal", {}, f"cannot play {reason}" if reason else "")]
    candidates += [RungOption(n, rung.provides, _refusal(scene, n)) for n, rung in RUNGS.items()]
    return choose(f"scene {scene.name}", scene.needs, scene.tolerance, candidates)


def explain(scene: Scene) -> str:
    """For people: which rung plays the scene, why, and what it does not model.

    This is for simulated time; `prepare.explain_in_real_time` says what a board makes of it.

    Raises
    ------
    ConfigError
        None does, or not the one that the scene names: what playing it would say.
    """
    if scene.contact == "auto":
        return choose_rung(scene).explain()
    if scene.contact != "signal" and (reason := _refusal(scene, scene.contact)):
        raise ConfigError(f"scene {scene.name}", [reason])
    return f"contact: {scene.contact}\n  the scene says so\n  not modelled: {NOT_MODELLED[scene.contact]}"


def _builder(scene: Scene, name: str) -> Build:
    build = RUNGS[name].build
    return partial(build, readout=scene.readout)


def _refusal(scene: Scene, name: str) -> str:
    """Why a rung cannot be built for the plates of a scene; empty where it can."""
    try:
        for plate in SceneMotion(scene).surfaces:
            _builder(scene, name)(rung_surface(plate, name), np.zeros(1), 1)
    except ConfigError as error:
        return "; ".join(error.faults)
    return ""


class RungBuilder(Protocol):
    """Class of a rung."""

    def __call__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, *, readout: Readout
    ) -> Rung: ...


@dataclass(frozen=True)
class RungEntry:
    """A physical rung as scenes choose it.

    Attributes
    ----------
    build : callable
        ``(surface, azimuth_deg: (a,), n_taxels, *, readout) -> Rung``; raises `ConfigError` naming what it
        cannot do.
    provides : dict
        Need (see `scene.Need`) to measured relative error; the rung module's ``PROVIDES``.
    step_s : float
        Step of its time grid.
    """

    build: RungBuilder
    provides: Mapping[str, float]
    step_s: float


RUNGS: dict[str, RungEntry] = {
    "lumped": RungEntry(lumped.Lumped, lumped.PROVIDES, lumped.STEP_S),
    "periodic": RungEntry(periodic.Periodic, periodic.PROVIDES, periodic.STEP_S),
    "compliance": RungEntry(compliance.Compliance, compliance.PROVIDES, compliance.STEP_S),
}
"""Physical rungs, cheapest first. ``signal`` is none of them: it prescribes."""
