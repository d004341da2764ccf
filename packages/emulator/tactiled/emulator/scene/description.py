"""Scenes: motion and load of the skin, as TOML (``config/scenes/*.toml``).

A scene is a list of phases. Scene time is 0 at the first ``start`` command to the board (at power-up for a
board without commands), so that a host that comes late misses nothing. After the last phase the skin stays
in its last state.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from tactiled import resources, tomlfile
from tactiled.emulator.board.electronics import ElectronicsParams
from tactiled.emulator.scene.phases import (
    Disturbance,
    FlatPlate,
    GroovedPlate,
    HeldObject,
    HoldPhase,
    LiftPhase,
    LoadPhase,
    Phase,
    PressPhase,
    RestPhase,
    RotatePhase,
    SlidePhase,
    Surface,
)
from tactiled.tomlfile import Params

# A tenfold load within a millimetre; no array is on a steeper surface.
Gradient = Annotated[float, Field(ge=-10, le=10)]


class Scene(Params):
    """Schema of ``config/scenes/*.toml``, and the scene itself."""

    name: str = Field(min_length=1)
    description: str = ""
    array: str = Field(default="wang2019-3x3", description="name or file of the array")
    contact: Literal["signal", "mechanics"] = Field(
        default="signal", description="prescribed signals, or mechanics of skin and plates"
    )
    seed: int = Field(
        default=1, ge=0, lt=2**63, description="of the noise and of the differences between taxels"
    )
    surface: Surface = FlatPlate()
    electronics: ElectronicsParams = ElectronicsParams()
    phases: list[Phase] = Field(min_length=1)
    disturbances: list[Disturbance] = []
    held_object: HeldObject | None = Field(
        default=None, description="object in the grip; absent: a plate that is moved"
    )
    touching: list[int] = Field(default=[], description="taxels that reach the surface; empty: all")
    load_gradient_per_mm: tuple[Gradient, Gradient] = Field(
        default=(0.0, 0.0), description="relative growth of a taxel's load along x and y: a tilted surface"
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        loaded = False
        for index, phase in enumerate(self.phases):
            if isinstance(phase, HoldPhase | SlidePhase | LiftPhase | RotatePhase) and not loaded:
                raise ValueError(f"phases[{index}]: a {phase.kind} needs contact; put a press before it")
            if isinstance(phase, RestPhase) and loaded:
                raise ValueError(f"phases[{index}]: a rest touches nothing; use hold, or lift before it")
            if isinstance(phase, LoadPhase) and not loaded and phase.force_n is None:
                raise ValueError(f"phases[{index}]: a load needs contact; give force_n, or a press before it")
            loaded = isinstance(phase, PressPhase | LoadPhase) or (
                loaded and not isinstance(phase, LiftPhase)
            )
        return self

    @model_validator(mode="after")
    def _held(self) -> Self:
        """Refuse phases that do not fit a held object, that need one, or that signals cannot prescribe."""
        held = self.held_object
        if held is not None and not any(getattr(phase, "force_n", None) for phase in self.phases):
            raise ValueError("held_object: nothing grips it; add a press")
        if held is not None and isinstance(self.surface, GroovedPlate):
            raise ValueError('surface: a held object has a flat one; give kind = "flat"')
        for index, phase in enumerate(self.phases):
            if isinstance(phase, LoadPhase) and held is None:
                raise ValueError(f"phases[{index}]: a load pulls at an object; add [held_object]")
            if held is not None and isinstance(phase, RotatePhase):
                raise ValueError(f"phases[{index}]: a held object moves by its load and does not turn")
            if held is not None and isinstance(phase, SlidePhase) and not held.spring_n_mm:
                raise ValueError(
                    f"phases[{index}]: a slide drags a held object; give held_object.spring_n_mm"
                )
            if held is not None and phase.surface is not None:
                raise ValueError(f"phases[{index}]: a held object has one surface; put it into the scene")
        for index, extra in enumerate(self.disturbances):
            if extra.on in ("pull_n", "friction") and held is None:
                raise ValueError(f"disturbances[{index}]: {extra.on} is of an object; add [held_object]")
        reasons = [f"a {p.kind} phase" for p in self.phases if isinstance(p, RotatePhase | LoadPhase)]
        reasons += ["a held object"] * (held is not None)
        reasons += ["touching"] * bool(self.touching)
        reasons += ["load_gradient_per_mm"] * any(self.load_gradient_per_mm)
        if self.contact == "signal" and reasons:
            raise ValueError(f'contact = "signal" prescribes and cannot play {reasons[0]}; use "mechanics"')
        return self

    @property
    def duration_s(self) -> float:
        return sum(phase.duration_s for phase in self.phases)

    def with_changes(self, **changes: object) -> "Scene":
        """Copy with top-level keys changed, checked as a file is: ``scene.with_changes(seed=7)``."""
        return tomlfile.parse(self.model_dump() | changes, Scene, f"variation of scene {self.name}")


def load_scene(name_or_path: str) -> Scene:
    """Load a scene by shipped name (``demo``) or path; `ConfigError` has all faults of the file."""
    return tomlfile.load(resources.find(name_or_path, "config/scenes"), Scene)
