"""Words of the joint estimator: what is known of the motion, what may be answered, what was found.

The model. Grooves of period D with normal (cos a, sin a) are a plane wave with wave vector
``k = (2 pi / D) (cos a, sin a)``. A channel at (x, y), sampled `offset_s` after its scan began, sees the
phase ``psi = kappa s(t + offset_s) + kx x + ky y``, where s is the way travelled (or, where the speed is not
known, the time) and kappa the phase for each unit of it. Its reading is a slow polynomial, plus
``a_h cos(h psi + phi_h)`` for each harmonic h, plus noise. Amplitudes ``a_h >= 0`` are each channel's own.
Phases ``phi_h`` are common to channels that measure the same thing (all R1, say): on a real skin R1 and R3
of a taxel do not feel a ridge at the same time, but R1 and R1 of two taxels do, up to their distance.

With motion of speed v along direction theta, ``kappa = v |k| cos(theta - a)``: a known motion ties frequency
to wave vector, an unknown one is found from the two.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.events.types import UNKNOWN_SD_DEG, Candidate, TextureStatus
from tactiled.tomlfile import Params


class WaveParams(Params):
    """What the joint fit may answer, and how sure it must be.

    The limits are the operator's: they tell readings apart that phases cannot, and grooves outside them may
    be taken for others inside.
    """

    min_period_mm: float = Field(default=0.5, ge=0.05, description="grooves are not finer than this")
    max_period_mm: float = Field(default=20.0, gt=0.05, description="nor coarser than this")
    max_tilt_deg: float = Field(
        default=88.0,
        gt=0,
        lt=90,
        description="between groove normal and motion; beyond, the skin slides along the grooves",
    )
    max_harmonics: int = Field(default=3, ge=1, le=6, description="of the ripple, where they are seen")
    trend_order: int = Field(
        default=3,
        ge=1,
        le=8,
        description="of the polynomial that drift and creep are; a line where ripples are few",
    )
    min_periods: float = Field(default=0.8, ge=0.7, le=50, description="fewer in a window are not enough")
    error_probability: float = Field(
        default=1e-3, gt=0, lt=0.5, description="of a wrong answer among all that the phases allow"
    )


@dataclass(frozen=True)
class WaveMotion:
    """What is known of the slide: that of the skin over the surface.

    A speed of 0 is not known; a direction is not known where its sigma is 90 degrees or more.
    """

    speed_mm_s: float = 0.0
    speed_sd_mm_s: float = 0.0
    direction_deg: float = 0.0
    direction_sd_deg: float = UNKNOWN_SD_DEG

    @property
    def has_direction(self) -> bool:
        return self.direction_sd_deg < 90.0

    @property
    def has_speed(self) -> bool:
        """Whether frequency and wave vector are tied; a speed without its direction does not do that."""
        return self.speed_mm_s > 0 and self.has_direction

    @property
    def without_speed(self) -> "WaveMotion":
        return replace(self, speed_mm_s=0.0, speed_sd_mm_s=0.0)

    @property
    def heading(self) -> FloatArray:
        """Unit vector of the motion."""
        theta = np.radians(self.direction_deg)
        return np.array([np.cos(theta), np.sin(theta)])


@dataclass(frozen=True, eq=False)
class Layout:
    """Where channels are, and which of them measure the same thing.

    Attributes
    ----------
    x_mm, y_mm : (channels,) float64
    kind : (channels,) int64
        Channels of one number share the ripple's own phase.
    """

    x_mm: FloatArray
    y_mm: FloatArray
    kind: NDArray[np.int64]

    @cached_property
    def is_kind(self) -> FloatArray:
        """1 where the channel is of the kind: (channels, kinds)."""
        return np.asarray((self.kind[:, np.newaxis] == np.unique(self.kind)).astype(np.float64))

    @cached_property
    def places_mm(self) -> FloatArray:
        """Where taxels are: (taxels, 2)."""
        return self._places[0]

    @cached_property
    def taxel(self) -> NDArray[np.int64]:
        """Which of the places each channel is at: (channels,)."""
        return self._places[1]

    @cached_property
    def _places(self) -> tuple[FloatArray, NDArray[np.int64]]:
        places, taxel = np.unique(np.stack([self.x_mm, self.y_mm], axis=1), axis=0, return_inverse=True)
        return places, taxel.reshape(-1)

    @cached_property
    def rim_mm(self) -> float:
        """From the middle to the farthest channel; half a millimetre for what is smaller."""
        return max(float(np.hypot(self.x_mm, self.y_mm).max()), 0.5)


def layout_of(array: Array) -> Layout:
    """Channels of an array; those of one kind, azimuth and sign measure the same thing."""
    names = [
        (kind, -1.0 if np.isnan(azimuth) else float(azimuth), float(sign))
        for kind, azimuth, sign in zip(array.channel_kind, array.azimuth_deg, array.sign, strict=True)
    ]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    return Layout(
        array.x_mm[array.channel_taxel],
        array.y_mm[array.channel_taxel],
        np.array([numbers[name] for name in names], dtype=np.int64),
    )


@dataclass(frozen=True, eq=False)
class WaveFit:
    """Answer for one window; zeros where `status` is not "ok".

    Attributes
    ----------
    covariance : (3, 3) float64
        Of period (mm), angle (radians) and speed (mm/s).
    is_tied : bool
        Whether the speed is what was given; it is not where the phases belie that.
    colour : float
        By which noise near the line makes the largest variance wider than white noise would.
    error_probability : float
        That another reading of the phases is the true one.
    second : WaveFit or None
        Another grating beside this one, with less power.
    """

    status: TextureStatus
    frequency_hz: float = 0.0
    snr_db: float = 0.0
    period_mm: float = 0.0
    angle_deg: float = 0.0
    speed_mm_s: float = 0.0
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    n_harmonics: int = 0
    is_tied: bool = False
    colour: float = 1.0
    error_probability: float = 1.0
    candidates: tuple[Candidate, ...] = ()
    second: "WaveFit | None" = None

    @property
    def period_sd_mm(self) -> float:
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def angle_sd_deg(self) -> float:
        return float(np.degrees(np.sqrt(self.covariance[1, 1])))

    @property
    def speed_sd_mm_s(self) -> float:
        return float(np.sqrt(self.covariance[2, 2]))

    @property
    def gratings(self) -> tuple[Candidate, ...]:
        """This and the second, with their shares of the ripple's power for weights."""
        both = [self] if self.second is None else [self, self.second]
        powers = np.array([10 ** (grating.snr_db / 10) for grating in both])
        return tuple(
            Candidate(period_mm=grating.period_mm, angle_deg=grating.angle_deg, weight=float(weight))
            for grating, weight in zip(both, powers / powers.sum(), strict=True)
        )
