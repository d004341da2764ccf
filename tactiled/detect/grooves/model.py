"""Plane-wave model of a grooved surface, the motion over it and the channels that sense it.

Grooves of period D with normal (cos a, sin a) are a plane wave with the wave vector
``k = (2 pi / D) (cos a, sin a)``. A channel at (x, y) that is sampled `offset_s` after its scan began sees
the phase ``psi = omega s(t + offset_s) + kx x + ky y``. Here s is the distance travelled (or the time, where
the speed is unknown) and omega, the phase rate, is the phase per unit of s. The reading of a channel is a
slow polynomial, plus ``a_h cos(h psi + phi_h)`` for each harmonic h, plus noise.

The amplitudes ``a_h >= 0`` belong to each channel. The phases ``phi_h`` are common to all channels of one
kind (all R1, for example): on a real skin R1 and R3 of one taxel do not feel a ridge at the same time, but
the R1 of two taxels do, apart from the delay that their distance makes. With motion of speed v along the
direction theta, ``omega = |k| cos(theta - a)`` per millimetre and ``v |k| cos(theta - a)`` per second.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.events.types import UNKNOWN_SD_DEG

# choice: fraction of the scan rate. Near half the rate, the line of a ripple overlaps that of its mirror
# image; above, only phases tell which of the two is true.
ALIASED = 0.45
# prior: phase at the edge of the array. Wave vectors that differ by less are the same wave.
SAME_WAVE_RAD = 0.3
# choice: candidates in an event.
MAX_CANDIDATES = 8
# choice: probability that noise passes for what is looked for: a line, a harmonic, another wave, a motion, a
# pattern.
FALSE_ALARM = 1e-6
# choice: probability that white noise on equal channels passes for what makes an answer less sure: strays,
# noise beside the line, a second wave of its frequency.
FALSE_DOUBT = 1e-2
# derived: divisor in place of zero, for channels without any ripple.
TINY = 1e-300
# derived: root mean square of half the square of a variable with unit variance.
_SECOND_ORDER = np.sqrt(3) / 2


@dataclass(frozen=True)
class WaveMotion:
    """Known motion of the skin over the surface, with standard deviations.

    A speed of 0 means unknown. A direction with a standard deviation of 90 degrees or more is unknown.
    """

    speed_mm_s: float = 0.0
    speed_sd_mm_s: float = 0.0
    direction_deg: float = 0.0
    direction_sd_deg: float = UNKNOWN_SD_DEG

    @property
    def has_direction(self) -> bool:
        """True where the direction is known."""
        return self.direction_sd_deg < 90.0

    @property
    def has_speed(self) -> bool:
        """True where the motion ties the frequency to the wave vector: speed and direction are known."""
        return self.speed_mm_s > 0 and self.has_direction

    @property
    def without_speed(self) -> "WaveMotion":
        """The motion with its speed made unknown."""
        return replace(self, speed_mm_s=0.0, speed_sd_mm_s=0.0)

    @property
    def heading(self) -> FloatArray:
        """Unit vector of the motion: (2,)."""
        theta = np.radians(self.direction_deg)
        return np.array([np.cos(theta), np.sin(theta)])

    @property
    def across(self) -> FloatArray:
        """Unit vector across the motion, to its left: (2,)."""
        heading = self.heading
        return np.array([-heading[1], heading[0]])

    def along_sd(self, k: FloatArray) -> FloatArray:
        """Standard deviation (waves,) of the component of k along the motion, from frequency and speed."""
        along, across, sd = k @ self.heading, k @ self.across, np.radians(self.direction_sd_deg)
        by_speed = along * (self.speed_sd_mm_s / self.speed_mm_s)
        # Error of cos(tilt + error) to first and second order: the first vanishes where normal and motion
        # coincide.
        return np.asarray(np.linalg.norm([by_speed, across * sd, along * _SECOND_ORDER * sd**2], axis=0))


@dataclass(frozen=True, eq=False)
class ChannelLayout:
    """Positions of channels, and which of them respond alike."""

    # x_mm, y_mm: (channels,)
    x_mm: FloatArray
    y_mm: FloatArray
    # (channels,): channels with the same number share the phases ``phi_h`` of the ripple
    kind: NDArray[np.int64]

    @cached_property
    def is_kind(self) -> FloatArray:
        """Kind membership: (channels, kinds), 1 where the channel is of the kind, else 0."""
        return np.asarray((self.kind[:, np.newaxis] == distinct(self.kind)).astype(np.float64))

    def centred(self, chosen: NDArray[np.int64]) -> "ChannelLayout":
        """Return the layout of some channels about the middle of their places."""
        x_mm, y_mm = self.x_mm[chosen], self.y_mm[chosen]
        middle = (x_mm.min() + x_mm.max()) / 2, (y_mm.min() + y_mm.max()) / 2
        return ChannelLayout(x_mm - middle[0], y_mm - middle[1], self.kind[chosen])

    @cached_property
    def xy_mm(self) -> FloatArray:
        """Positions of the channels: (channels, 2)."""
        return np.stack([self.x_mm, self.y_mm], axis=1)

    @cached_property
    def places_mm(self) -> FloatArray:
        """Positions of the taxels: (taxels, 2)."""
        return np.array(sorted(set(map(tuple, self.xy_mm.tolist()))))

    @cached_property
    def taxel(self) -> NDArray[np.int64]:
        """Row in `places_mm` of each channel: (channels,)."""
        row = {place: row for row, place in enumerate(map(tuple, self.places_mm.tolist()))}
        return np.array([row[place] for place in map(tuple, self.xy_mm.tolist())], dtype=np.int64)

    @cached_property
    def radius_mm(self) -> float:
        """Distance from the origin to the farthest channel, at least 0.5 mm."""
        return max(float(np.hypot(self.x_mm, self.y_mm).max()), 0.5)


def distinct(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the different values in order."""
    # `np.unique` would load numpy's masked arrays: 2 MB and 20 ms for nothing else.
    return np.array(sorted(set(values.tolist())), dtype=np.int64)


def channel_layout(array: Array) -> ChannelLayout:
    """Layout of an array; channels of equal type, azimuth and sign are of one kind."""
    names = [
        (kind, -1.0 if np.isnan(azimuth) else float(azimuth), float(sign))
        for kind, azimuth, sign in zip(array.channel_kind, array.azimuth_deg, array.sign, strict=True)
    ]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    return ChannelLayout(
        array.x_mm[array.channel_taxel],
        array.y_mm[array.channel_taxel],
        np.array([numbers[name] for name in names], dtype=np.int64),
    )


def period_and_angle(k: FloatArray) -> tuple[float, float]:
    """Period (mm) and angle (degrees, within -90..90) of a wave vector in radians per millimetre."""
    angle = np.arctan2(k[1], k[0])
    angle -= np.pi * np.round(angle / np.pi)
    return float(2 * np.pi / np.hypot(k[0], k[1])), float(np.degrees(angle))


def wave_vector(period_mm: float, angle_deg: float) -> FloatArray:
    """Wave vector of a period and an angle, radians per millimetre: (2,)."""
    angle = np.radians(angle_deg)
    return 2 * np.pi / period_mm * np.array([np.cos(angle), np.sin(angle)])
