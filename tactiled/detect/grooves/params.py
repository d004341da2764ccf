"""Parameters of the joint groove estimator."""

from typing import Literal, NamedTuple

from pydantic import Field

from tactiled.tomlfile import Params

Preset = Literal["quick", "balanced", "fine"]


class AnswerCriteria(NamedTuple):
    """Precision and window that an answer must have."""

    period_sd_mm: float
    angle_sd_deg: float
    max_window_s: float
    answer_periods: float


# At 20 dB and 1.5 mm/s the standard deviations are 1 um and 0.04 degrees as soon as there is an answer
# (`./run bench texture`): the number of periods decides when it comes, the standard deviations where the
# signal is weak. "quick" takes the minimum; from 1.25 periods on errors reach the bound; from 2.5 on drift
# may be a curve.
PRESETS: dict[Preset, AnswerCriteria] = {
    "quick": AnswerCriteria(0.02, 1.0, 3.0, 0.8),
    "balanced": AnswerCriteria(0.005, 0.25, 8.0, 1.25),
    "fine": AnswerCriteria(0.001, 0.05, 20.0, 2.5),
}


class WaveParams(Params):
    """Limits of the joint fit and the error probability it must meet.

    The limits are the operator's knowledge of the surface. They exclude gratings that the phases alone cannot
    exclude; grooves outside the limits may be mistaken for others inside them.
    """

    min_period_mm: float = Field(default=0.5, ge=0.05, description="shortest groove period considered")
    max_period_mm: float = Field(default=20.0, gt=0.05, description="longest groove period considered")
    max_tilt_deg: float = Field(
        default=88.0,
        gt=0,
        lt=90,
        description="largest angle from groove normal to motion; beyond, the skin slides along grooves",
    )
    max_harmonics: int = Field(
        default=3, ge=1, le=6, description="harmonics of the ripple that are fitted, where they are visible"
    )
    trend_order: int = Field(
        default=3,
        ge=1,
        le=8,
        description="order of the polynomial for drift and creep; a straight line for few ripples",
    )
    min_periods: float = Field(
        default=0.8, ge=0.7, le=50, description="ripple periods that a window must hold"
    )
    error_probability: float = Field(
        default=1e-2,
        gt=0,
        lt=0.5,
        description="largest probability that an answer is wrong; the mean over answers is a tenth of it",
    )


class JointParams(WaveParams):
    """Parameters of the joint estimator."""

    preset: Preset = Field(default="balanced", description="defaults of the next four")
    period_sd_mm: float | None = Field(
        default=None, gt=0, description="standard deviation of the period that an answer needs"
    )
    angle_sd_deg: float | None = Field(
        default=None, gt=0, description="standard deviation of the angle that an answer needs"
    )
    max_window_s: float | None = Field(
        default=None, gt=0, le=120, description="longest window; answer then in any case"
    )
    answer_periods: float | None = Field(
        default=None, gt=0, le=50, description="ripple periods in the window that an earlier answer needs"
    )
    hop_s: float = Field(default=0.2, ge=0.02, le=10, description="interval between fits")
    # Two hops. A fit of straying channels takes 0.05 to 0.07 s in place (`./run bench texture`) and longer
    # beside the loop; on a busy host one may still wait for the fit before it.
    answer_after_s: float = Field(
        default=0.4,
        ge=0,
        le=10,
        description="time from the end of a window to its answer; the fit is computed meanwhile",
    )
    settle_s: float = Field(default=0.3, ge=0, le=60, description="time from detected slip to the window")
    speed_mm_s: float = Field(
        default=0.0, ge=0, le=1000, description="sliding speed; 0: unknown, to be estimated"
    )
    speed_sd_mm_s: float = Field(default=0.0, ge=0, description="standard deviation of the speed")
    direction_deg: float | None = Field(
        default=None,
        ge=-180,
        le=180,
        description="direction of the skin's motion, +x towards +y; left out: from the slip event",
    )

    @property
    def criteria(self) -> AnswerCriteria:
        """Criteria given explicitly, completed by those of the preset."""
        given = {name: getattr(self, name) for name in AnswerCriteria._fields}
        return PRESETS[self.preset]._replace(**{name: x for name, x in given.items() if x is not None})
