"""Contact models as scenes choose them: from load and travel to the force on every channel's read-out area.

A contact model computes forces at each channel's own sampling instants, in any chunking and possibly
twice, and must return the same values each time. To add a physical one, write a class in `mechanics`, and
enter it in `TAXEL_MODELS` and in `description.Contact`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics import compliance, lumped, periodic
from tactiled.emulator.mechanics.auto import NOT_MODELLED, ModelChoice, ModelOption, choose
from tactiled.emulator.mechanics.base import Readout, Surface, TaxelModel
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.physical import Build, ContactState, PhysicalContact
from tactiled.emulator.scene.prescribed import SignalContact
from tactiled.emulator.scene.taxels import model_surface
from tactiled.errors import ConfigError


class SceneContact(Protocol):
    """Contact of the skin with the surface, as a function of scene time."""

    def forces(self, time_s: FloatArray) -> FloatArray:
        """Forces (N) on each channel's read-out area.

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
        """Total load through the lag of the rubber's creep, at instants (n, channels)."""
        ...

    def load_and_peak_n(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Total load and its largest value since contact, at instants (n, channels)."""
        ...


class TaxelModelBuilder(Protocol):
    """Class of a `TaxelModel`."""

    def __call__(
        self, surface: Surface, azimuth_deg: FloatArray, n_taxels: int, *, readout: Readout
    ) -> TaxelModel:
        """Build the model; `ConfigError` names what it cannot do."""
        ...


@dataclass(frozen=True)
class TaxelModelEntry:
    """A physical contact model as scenes choose it."""

    build: TaxelModelBuilder
    # Need (see `description.Need`) to measured relative error: ``PROVIDES`` of the module
    provides: Mapping[str, float]
    step_s: float  # step of its time grid


TAXEL_MODELS: dict[str, TaxelModelEntry] = {
    "lumped": TaxelModelEntry(lumped.Lumped, lumped.PROVIDES, lumped.STEP_S),
    "periodic": TaxelModelEntry(periodic.Periodic, periodic.PROVIDES, periodic.STEP_S),
    "compliance": TaxelModelEntry(compliance.Compliance, compliance.PROVIDES, compliance.STEP_S),
}
"""Physical contact models, cheapest first. ``signal`` is not among them: its forces are prescribed."""


def make_contact(motion: SceneMotion, array: Array) -> SceneContact:
    """Contact model of a scene.

    Raises
    ------
    ConfigError
        No contact model, or not the one that the scene names, can play it.
    """
    name = model_name(motion.scene)
    if name == "signal":
        return SignalContact(motion, array)
    build, step_s = _builder(motion.scene, name), TAXEL_MODELS[name].step_s
    return PhysicalContact(motion, array, build, step_s, name)


def model_name(scene: Scene) -> str:
    """Name of the contact model that plays a scene."""
    return choose_model(scene).name if scene.contact == "auto" else scene.contact


def choose_model(scene: Scene) -> ModelChoice:
    """Choose the cheapest contact model that meets the needs of a scene.

    Raises
    ------
    ConfigError
        There is none.
    """
    reason = scene.needs_mechanics
    candidates = [ModelOption("signal", {}, f"cannot play {reason}" if reason else "")]
    candidates += [ModelOption(n, entry.provides, _refusal(scene, n)) for n, entry in TAXEL_MODELS.items()]
    return choose(f"scene {scene.name}", scene.needs, scene.tolerance, candidates)


def explain(scene: Scene) -> str:
    """Explain in words which contact model plays the scene, why, and what it does not model.

    This holds for simulated time; `prepare.explain_in_real_time` is for a board in real time.

    Raises
    ------
    ConfigError
        No contact model can play the scene, or not the one that the scene names.
    """
    if scene.contact == "auto":
        return choose_model(scene).explain()
    if scene.contact != "signal" and (reason := _refusal(scene, scene.contact)):
        raise ConfigError(f"scene {scene.name}", [reason])
    return f"contact: {scene.contact}\n  named by the scene\n  not modelled: {NOT_MODELLED[scene.contact]}"


def _builder(scene: Scene, name: str) -> Build:
    return partial(TAXEL_MODELS[name].build, readout=scene.readout)


def _refusal(scene: Scene, name: str) -> str:
    """Reason why a contact model cannot be built for the plates of a scene; empty where it can."""
    try:
        for plate in SceneMotion(scene).surfaces:
            _builder(scene, name)(model_surface(plate, name), np.zeros(1), 1)
    except ConfigError as error:
        return "; ".join(error.faults)
    return ""
