"""Parts of a scene: plates, phases, disturbances, a held object."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from tactiled.tomlfile import Params

_SHORTEST_S = 0.001  # a tenth of a scan: shorter changes cannot be seen
LARGEST_FORCE_N = 2000.0  # of a load, a grip or a pull
Duration = Annotated[float, Field(ge=_SHORTEST_S, le=86400, description="seconds that the phase lasts")]


Unevenness = Annotated[
    float, Field(ge=0, le=0.5, description="standard deviation of friction from place to place over its mean")
]


class Plate(Params):
    """Parameters of every plate."""

    friction: float = Field(default=0.6, ge=0, le=3, description="Coulomb coefficient, while sliding")
    static_ratio: float = Field(
        default=1.0, ge=1, le=3, description="friction at rest over friction while sliding"
    )
    stribeck_mm_s: float = Field(
        default=1.0, ge=1e-6, le=1e6, description="speed scale over which friction falls to that of sliding"
    )
    unevenness: Unevenness = 0.0


class FlatPlate(Plate):
    """Plate without texture."""

    kind: Literal["flat"] = "flat"
    # Without it, shear that slides and shear that rests are the same signal: no real plate is that even.
    unevenness: Unevenness = 0.05


class GroovedPlate(Plate):
    """Plate with parallel grooves; their normal is at `angle_deg` from +x towards +y."""

    kind: Literal["grooves"]
    period_mm: float = Field(gt=0.01, le=100, description="distance of ridges along the groove normal")
    angle_deg: float = Field(default=0.0, gt=-90, le=90, description="0: grooves parallel to y")
    # The paper gives no depth; finite elements were run with 0.1 mm.
    depth_mm: float = Field(
        default=0.1, gt=0, le=5, description="height of ridges, for physical contact models"
    )
    # Wang 2019, figure of the angle study: total force on one unit ripples by 0.08 N (peak to trough) at
    # 0 degrees under 15 N / 9 a unit, that is +-2.4 %; divided by the aperture's 0.58 at 1.2 mm.
    ripple: float = Field(
        default=0.042, ge=0, le=0.8, description="relative force amplitude at long periods, 0 degrees"
    )


Surface = Annotated[FlatPlate | GroovedPlate, Field(discriminator="kind")]


class PhaseBase(Params):
    """Parameters of every phase."""

    duration_s: Duration
    surface: Surface | None = Field(default=None, description="plate from this phase on; absent: as before")


class RestPhase(PhaseBase):
    """No contact."""

    kind: Literal["rest"]


class PressPhase(PhaseBase):
    """The total load on the array changes linearly to `force_n`."""

    kind: Literal["press"]
    force_n: float = Field(gt=0, le=LARGEST_FORCE_N)


class HoldPhase(PhaseBase):
    """The load is constant and nothing moves."""

    kind: Literal["hold"]


class LiftPhase(PhaseBase):
    """The load falls linearly to zero."""

    kind: Literal["lift"]


class SlidePhase(PhaseBase):
    """The skin moves over the surface under constant load; a reversal is a second slide."""

    kind: Literal["slide"]
    speed_mm_s: float = Field(gt=0, le=1000)
    direction_deg: float = Field(default=0.0, ge=-360, le=360, description="from +x towards +y")
    ramp_s: float = Field(default=0.0, ge=0, le=86400, description="time to reach the speed, linearly from 0")

    @model_validator(mode="after")
    def _possible_ramp(self) -> Self:
        if self.ramp_s > self.duration_s or 0 < self.ramp_s < _SHORTEST_S:
            raise ValueError(f"ramp_s must be 0, or from {_SHORTEST_S} s to the length of the phase")
        return self


class RotatePhase(PhaseBase):
    """The skin turns evenly about the middle of the array by `angle_deg`, positive from +x towards +y."""

    kind: Literal["rotate"]
    angle_deg: float = Field(ge=-3600, le=3600)


class LoadPhase(PhaseBase):
    """The load of a held object changes linearly to `tangential_n`, and the grip to `force_n` if given.

    The direction is that in which the skin would slip over the object, opposite to the pull on the object.
    """

    kind: Literal["load"]
    tangential_n: float = Field(ge=0, le=LARGEST_FORCE_N)
    direction_deg: float = Field(default=0.0, ge=-360, le=360, description="from +x towards +y")
    force_n: float | None = Field(
        default=None, gt=0, le=LARGEST_FORCE_N, description="absent: the grip is constant"
    )


Phase = Annotated[
    RestPhase | PressPhase | HoldPhase | SlidePhase | LiftPhase | RotatePhase | LoadPhase,
    Field(discriminator="kind"),
]


class Disturbance(Params):
    """Addition to the phases, such as vibration, taps, tugs or warming."""

    on: Literal["load_n", "pull_n", "temperature_k", "friction"] = Field(
        description="quantity that it adds to: grip, pull on a held object, temperature, relative change of "
        "a held object's friction"
    )
    shape: Literal["sine", "pulse", "ramp"] = Field(
        description="sine of frequency_hz that grows and fades over a tenth of the time each; pulse: half a "
        "sine squared; ramp: a line that stays at its end"
    )
    amplitude: float = Field(ge=-1000, le=1000, description="in the unit that ends the name in `on`")
    start_s: float = Field(default=0.0, ge=0, le=1e6)
    duration_s: Duration = 1.0
    frequency_hz: float = Field(default=50.0, gt=0, le=200, description="of a sine")
    direction_deg: float = Field(default=0.0, ge=-360, le=360, description="of a pull")


class HeldObject(Params):
    """Object between the skin and an equal finger; it slips when its load exceeds the friction limit."""

    mass_kg: float = Field(default=0.2, ge=0.02, le=50, description="part of the mass that this skin carries")
    spring_n_mm: float = Field(
        default=0.0,
        ge=0,
        le=1000,
        description="stiffness of a spring whose far end is moved by slides; 0: no slides",
    )
    grip_rate_n_s: float = Field(
        default=200.0, ge=1e-3, le=1e6, description="rate at which the grip follows a controller"
    )
    grip_delay_s: float = Field(
        default=0.0, ge=0, le=10, description="time after which the grip begins to follow a controller"
    )
    grip_step_n: float = Field(
        default=0.0, ge=0, le=100, description="resolution of a controller's grip; 0: as fine as its number"
    )
    fall_mm: float = Field(
        default=20.0, ge=1e-3, le=1e6, description="slip after which the object has fallen"
    )
