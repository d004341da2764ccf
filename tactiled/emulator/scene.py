"""Scenes: what the skin goes through, as TOML (``config/scenes/*.toml``).

A scene is a list of phases, one after the other. Scene time starts at 0 when the board first gets its
``start`` command (at power-up for a board that knows no commands), so nothing is missed by a host that
comes late; after the last phase the skin stays as that phase left it.
"""

import itertools
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from tactiled import resources, tomlfile
from tactiled.emulator.electronics import ElectronicsParams
from tactiled.tomlfile import Params

_SHORTEST_S = 0.001  # a tenth of a scan: shorter changes cannot be seen and only strain the arithmetic
Duration = Annotated[float, Field(ge=_SHORTEST_S, le=86400, description="seconds that the phase lasts")]


class Plate(Params):
    """What all plates have."""

    friction: float = Field(default=0.6, ge=0, le=3, description="Coulomb coefficient, while sliding")
    static_ratio: float = Field(default=1.0, ge=1, le=3, description="friction at rest over while sliding")
    stribeck_mm_s: float = Field(
        default=1.0, gt=0, description="speed over which friction falls to sliding's"
    )
    entry_mm: float = Field(
        default=1.0, gt=0, description="travel over which a sliding skin comes fully onto this plate"
    )


class Flat(Plate):
    """A plate without texture."""

    kind: Literal["flat"] = "flat"


class Grooves(Plate):
    """A plate with parallel grooves; the groove normal lies at `angle_deg` from +x towards +y."""

    kind: Literal["grooves"]
    period_mm: float = Field(gt=0.01, le=100, description="from ridge to ridge, along the groove normal")
    angle_deg: float = Field(default=0.0, gt=-90, le=90, description="0: grooves parallel to y")
    # The paper gives no depth; finite elements were run with 0.1 mm.
    depth_mm: float = Field(default=0.1, gt=0, le=5, description="ridge over valley, for physical rungs")
    offset_mm: float = Field(
        default=0.0,
        description="place of a ridge, along the groove normal from the array's origin, at the start",
    )
    # Wang 2019, figure of the angle study: total force on one unit ripples by 0.08 N (peak to trough) at
    # 0 degrees under 15 N / 9 a unit, that is +-2.4 %; divided by the aperture's 0.58 at 1.2 mm.
    ripple: float = Field(
        default=0.042, ge=0, le=0.8, description="relative force amplitude at long periods, 0 degrees"
    )
    harmonics: list[float] = Field(
        default=[0.2, 0.05], max_length=8, description="amplitudes of the 2nd, 3rd, ... over the first"
    )

    @model_validator(mode="after")
    def _positive_force(self) -> Self:
        if self.ripple * (1 + sum(map(abs, self.harmonics))) >= 1:
            raise ValueError("ripple with its harmonics would pull at the skin: keep their sum below 1")
        return self


Surface = Annotated[Flat | Grooves, Field(discriminator="kind")]


class Still(Params):
    """What all phases have."""

    duration_s: Duration
    surface: Surface | None = Field(default=None, description="the plate from here on; absent: as before")


class Rest(Still):
    """Nothing is touched."""

    kind: Literal["rest"]


class Press(Still):
    """The load goes linearly to `force_n`, in total on the array."""

    kind: Literal["press"]
    force_n: float = Field(gt=0, le=2000)


class Hold(Still):
    """The load stays and nothing moves."""

    kind: Literal["hold"]


class Lift(Still):
    """The load goes linearly to zero."""

    kind: Literal["lift"]


class Slide(Still):
    """The skin moves over the surface under the load it has; a speed reversal is a second slide."""

    kind: Literal["slide"]
    speed_mm_s: float | None = Field(default=None, gt=0, le=1000)
    direction_deg: float = Field(default=0.0, ge=-360, le=360, description="from +x towards +y")
    ramp_s: float = Field(default=0.0, ge=0, description="time to reach the speed, linearly from 0")
    ripple_mm_s: float = Field(default=0.0, ge=0, description="amplitude of a sine on the speed")
    ripple_hz: float = Field(default=1.0, gt=0, le=50)
    profile: list[tuple[float, Annotated[float, Field(ge=0, le=1000)]]] = Field(
        default=[], description="instead of a speed: pairs of seconds into the phase and mm/s"
    )

    @model_validator(mode="after")
    def _one_speed(self) -> Self:
        if (self.speed_mm_s is None) == (not self.profile):
            raise ValueError("give either speed_mm_s or profile")
        if self.profile and (self.ramp_s or self.ripple_mm_s):
            raise ValueError("ramp_s and ripple_mm_s belong to speed_mm_s, not to a profile")
        times = [t for t, _ in self.profile]
        if times and (times[0] != 0 or any(b - a < _SHORTEST_S for a, b in itertools.pairwise(times))):
            raise ValueError(f"profile times must begin at 0 and grow by at least {_SHORTEST_S} s")
        if times and times[-1] > self.duration_s:
            raise ValueError(f"profile goes on to {times[-1]} s, the phase only to {self.duration_s} s")
        if self.ramp_s > self.duration_s or 0 < self.ramp_s < _SHORTEST_S:
            raise ValueError(f"ramp_s must be 0, or from {_SHORTEST_S} s to the length of the phase")
        if self.speed_mm_s is not None and self.ripple_mm_s > self.speed_mm_s:
            raise ValueError("ripple_mm_s is larger than speed_mm_s: the skin would move backwards")
        return self


class Rotate(Still):
    """The skin turns about the middle of the array by `angle_deg`, evenly; +x towards +y is positive."""

    kind: Literal["rotate"]
    angle_deg: float = Field(ge=-3600, le=3600)


class Load(Still):
    """The held object's load goes linearly to `tangential_n`, and the grip with it to `force_n` if given.

    Directions are those in which the skin would slip over the object, against the pull on the object.
    """

    kind: Literal["load"]
    tangential_n: float = Field(ge=0, le=2000)
    direction_deg: float = Field(default=0.0, ge=-360, le=360, description="from +x towards +y")
    force_n: float | None = Field(default=None, gt=0, le=2000, description="absent: the grip stays")


Phase = Annotated[Rest | Press | Hold | Slide | Lift | Rotate | Load, Field(discriminator="kind")]


class Disturbance(Params):
    """What comes on top of the phases: motors, taps, tugs, warmth."""

    on: Literal["load_n", "pull_n", "travel_mm", "temperature_k"] = Field(
        description="what it adds to: grip, pull on a held object, place of the skin, temperature"
    )
    shape: Literal["sine", "pulse", "ramp"] = Field(
        description="sine of frequency_hz, swelling and dying over a tenth of the time each; half a sine "
        "squared over the whole time; a line that stays at its end"
    )
    amplitude: float = Field(ge=-1000, le=1000, description="in the unit that `on` ends in")
    start_s: float = Field(default=0.0, ge=0)
    duration_s: Duration = 1.0
    frequency_hz: float = Field(default=50.0, gt=0, le=200, description="of a sine")
    direction_deg: float = Field(default=0.0, ge=-360, le=360, description="of a pull or a travel")


class HeldObject(Params):
    """An object between the skin and an equal finger: it slips when its load is more than friction bears."""

    mass_kg: float = Field(default=0.2, ge=0.02, le=50, description="the part that this skin carries")
    spring_n_mm: float = Field(
        default=0.0, ge=0, le=1000, description="slides move the far end of such a spring; 0: no slides"
    )
    grip_rate_n_s: float = Field(default=200.0, gt=0, description="how fast a controller's grip is followed")
    fall_mm: float = Field(default=20.0, gt=0, description="slipped so far, the object has landed")


# Rungs of the ladder of contact models, in growing cost; "auto" picks the cheapest that meets `needs`.
Contact = Literal["auto", "signal", "lumped", "bristle", "compliance", "periodic"]
# What a scene can ask of its contact model. A rung says in its `PROVIDES` how wrong it is about each, as a
# part of the quantity's own size (direction: of 90 degrees; phase: of a turn; slip instants: of the travel
# from first shear to gross slip); what it does not name it does not model.
Need = Literal[
    "direction",  # of slip
    "gross-slip",  # instant at which everything slips
    "incipient-slip",  # slip spreading over the patch before
    "absolute-force",  # normal force against indentation
    "left-right",  # split between opposite read-out areas
    "tangential-force",  # friction force, also at the knee
    "groove-ripple",  # amplitude
    "groove-phase",
    "transients",  # changes of load, speed and direction while in contact
]


class Scene(Params):
    """Schema of ``config/scenes/*.toml``, and the scene itself."""

    name: str = Field(min_length=1)
    description: str = ""
    array: str = Field(default="wang2019-3x3", description="name or file of the array that is worn")
    contact: Contact = Field(default="signal", description="contact model: a rung of the ladder, or auto")
    held: Literal["force", "displacement"] = Field(
        default="force", description="what stays while sliding: the load, or the indentation that it makes"
    )
    needs: list[Need] = Field(default=[], description="what auto must find a rung for")
    tolerance: float = Field(default=0.1, gt=0, le=1, description="largest relative error of each need")
    readout: Literal["edge", "half"] = Field(
        default="edge", description="area under a side electrode, for physical rungs: mechanics/sides.py"
    )
    seed: int = Field(default=1, ge=0, lt=2**63, description="of the noise and of the taxels' inequality")
    surface: Surface = Flat()
    electronics: ElectronicsParams = ElectronicsParams()
    phases: list[Phase] = Field(min_length=1)
    disturbances: list[Disturbance] = []
    held_object: HeldObject | None = Field(
        default=None, description="what is held; absent: a plate that is moved"
    )
    touching: list[int] = Field(default=[], description="taxels that reach the surface; empty: all")
    load_gradient_per_mm: tuple[float, float] = Field(
        default=(0.0, 0.0), description="relative growth of a taxel's load along x and y: a tilted surface"
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        loaded = False
        for index, phase in enumerate(self.phases):
            if isinstance(phase, Hold | Slide | Lift | Rotate) and not loaded:
                raise ValueError(f"phases[{index}]: a {phase.kind} needs contact; put a press before it")
            if isinstance(phase, Rest) and loaded:
                raise ValueError(f"phases[{index}]: a rest touches nothing; use hold, or lift before it")
            if isinstance(phase, Load) and not loaded and phase.force_n is None:
                raise ValueError(f"phases[{index}]: a load needs contact; give force_n, or a press before it")
            loaded = isinstance(phase, Press | Load) or (loaded and not isinstance(phase, Lift))
        return self

    @model_validator(mode="after")
    def _held(self) -> Self:
        """What an object can do, and what only one that is held can."""
        held = self.held_object
        for index, phase in enumerate(self.phases):
            if isinstance(phase, Load) and held is None:
                raise ValueError(f"phases[{index}]: a load pulls at an object; add [held_object]")
            if held is not None and isinstance(phase, Rotate):
                raise ValueError(f"phases[{index}]: a held object moves by its load and does not turn")
            if held is not None and isinstance(phase, Slide) and not held.spring_n_mm:
                raise ValueError(
                    f"phases[{index}]: a slide drags a held object; give held_object.spring_n_mm"
                )
            if held is not None and phase.surface is not None:
                raise ValueError(f"phases[{index}]: a held object has one surface; put it into the scene")
        for index, extra in enumerate(self.disturbances):
            if extra.on == "pull_n" and held is None:
                raise ValueError(f"disturbances[{index}]: pull_n pulls at an object; add [held_object]")
        if held is not None and self.held == "displacement":
            raise ValueError("held: the grip on an object is a force")
        return self

    @model_validator(mode="after")
    def _not_prescribed(self) -> Self:
        """What needs mechanics."""
        if self.contact == "signal" and (reason := self.needs_mechanics):
            raise ValueError(f'contact = "signal" prescribes and cannot play {reason}; use "auto"')
        return self

    @property
    def needs_mechanics(self) -> str:
        """What of this scene cannot be prescribed; empty where all can."""
        reasons = [f"a {p.kind} phase" for p in self.phases if isinstance(p, Rotate | Load)]
        reasons += [f"a disturbance of {d.on}" for d in self.disturbances if d.on == "travel_mm"]
        reasons += ["a held object"] * (self.held_object is not None)
        return reasons[0] if reasons else ""

    @property
    def duration_s(self) -> float:
        return sum(phase.duration_s for phase in self.phases)

    def with_changes(self, **changes: object) -> "Scene":
        """Copy with top-level keys changed, checked like a file: ``scene.with_changes(seed=7)``."""
        return tomlfile.parse(self.model_dump() | changes, Scene, f"variation of scene {self.name}")

    def with_surface(self, **surface: object) -> "Scene":
        """Copy on another plate: ``with_surface(period_mm=1.2, angle_deg=30)`` or ``with_surface()``.

        Groove parameters given make grooves, with the scene's own grooves as their defaults; none make
        a flat plate. Where phases of the scene name grooves of their own, those are changed, else the
        plate of the whole scene.
        """
        document = self.model_dump()
        places = [p for p in document["phases"] if p["surface"] and p["surface"]["kind"] == "grooves"]
        for place in places or [document]:
            known = place["surface"] if place["surface"]["kind"] == "grooves" else {"kind": "grooves"}
            place["surface"] = known | surface if surface else {"kind": "flat"}
        return tomlfile.parse(document, Scene, f"variation of scene {self.name}")


def load_scene(name_or_path: str) -> Scene:
    """Scene by shipped name (``demo``) or by path; `ConfigError` with every fault of the file."""
    return tomlfile.load(resources.find(name_or_path, "config/scenes"), Scene)


def paper_scenes() -> dict[str, Scene]:
    """The protocols of the 2019 paper by name: slip twice, and each period and angle of its table 2.

    Groove scenes are named ``<experiment|simulation>-d<period>-a<angle>``.
    """
    scenes = {name: load_scene(name) for name in ("flat-experiment", "flat-simulation")}
    for kind in ("experiment", "simulation"):
        base = load_scene(f"grooves-{kind}")
        table = [(period, 0) for period in (0.9, 1.2, 1.5)] + [(1.2, angle) for angle in (15, 30, 45, 60)]
        for period_mm, angle_deg in table:
            name = f"{kind}-d{period_mm:.2f}-a{angle_deg}"
            varied = base.with_surface(period_mm=period_mm, angle_deg=angle_deg)
            scenes[name] = varied.with_changes(name=name)
    return scenes
