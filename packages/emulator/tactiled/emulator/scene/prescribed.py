"""Contact model `signal`: prescribed forces, without mechanics."""

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics.lumped import Lumped
from tactiled.emulator.mechanics.stepper import GridInterpolator
from tactiled.emulator.mechanics.unevenness import friction_factor
from tactiled.emulator.scene.loading import CreepLag
from tactiled.emulator.scene.motion import ComplexArray, SceneMotion
from tactiled.emulator.scene.phases import GroovedPlate
from tactiled.emulator.scene.physical import ContactState
from tactiled.emulator.scene.taxels import INEQUALITY

# Friction acts at the tip of the bump and tilts it: the imbalance of opposite side areas is the friction
# coefficient times height over lever arm, 1.3 mm (bump and adhesive) over some 0.87 mm. With friction 0.6
# that is 0.9, the "almost 100 %" change of Wang 2019. The limit is below 1, because an area carries no
# tension.
_TILT_PER_FRICTION = 1.5
_LARGEST_TILT = 0.95
# A taxel averages the grooves over its contact area. With a Gaussian aperture of this sigma the ripple grows
# from 0.9 to 1.5 mm periods about as much as in the paper's curves.
_APERTURE_SD_MM = 0.2
_HARMONICS = (0.2, 0.05)  # of the ripple: amplitudes of the 2nd and 3rd over the first
_LOADS_AT_ONCE = 1024  # steps: an hour of load is then computed in a second


class SignalContact:
    """Prescribed signals with the features of the paper's curves.

    A taxel carries ``N = load * share * (1 + rho)`` with the groove ripple rho. A side area at azimuth phi
    carries its part of N times ``1 - tilt (s . e_phi)`` with the tangential state s of `SceneMotion`. A shear
    channel reads ``mu N s``. The ripple is ``rho = A sum_k h_k cos(k phase)`` with the groove phase
    ``2 pi ((x + travel_x) cos a + (y + travel_y) sin a) / D`` and the amplitude
    ``A = ripple * cos(a) * exp(-2 (pi sigma / D)^2)``. The exponential is the Fourier transform of a Gaussian
    aperture; the cosine is the fall to one half from 0 to 60 degrees in Wang 2019.
    """

    def __init__(self, motion: SceneMotion, array: Array) -> None:
        self._motion = motion
        self._lag = CreepLag(Lumped.step_s, motion.scene.electronics.creep_time_s)
        self._relaxed = GridInterpolator(self, step_s=Lumped.step_s, block=_LOADS_AT_ONCE)
        rng = np.random.default_rng([motion.scene.seed, 1])
        taxel_share = _shares(rng, np.zeros(array.n_taxels, dtype=np.int64))
        self._taxel_share, self._taxel_mm = taxel_share, array.x_mm + 1j * array.y_mm
        kinds = np.array(array.channel_kind)
        taxel = array.channel_taxel
        self._part = taxel_share[taxel]
        side = kinds == "side"
        self._part[side] *= _shares(rng, taxel[side])
        azimuth = np.deg2rad(np.where(side, array.azimuth_deg, 0.0))
        self._side_x = np.where(side, -np.cos(azimuth).round(15), 0.0)
        self._side_y = np.where(side, -np.sin(azimuth).round(15), 0.0)
        self._shear_x = (kinds == "shear_x") * array.sign
        self._shear_y = (kinds == "shear_y") * array.sign
        self._tangential = (kinds == "shear_x") | (kinds == "shear_y")
        self._channel_mm = self._taxel_mm[taxel]

    def reset(self) -> None:
        """Return to scene time 0, for the grid of the creep's lag."""
        self._lag.reset()

    def advance(self, time_s: FloatArray) -> FloatArray:
        """Load (n, 1) through the creep's lag at the next n grid points."""
        return self._lag.feed(self._motion.at(time_s).load_n)[:, None]

    def forces(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `PhysicalContact.forces`."""
        state = self._motion.at(time_s)
        shear = state.shear
        friction, ripple = self._friction_and_ripple(time_s, self._channel_mm + state.travel_mm)
        normal = state.load_n * self._part * (1.0 + ripple)
        tilt = np.minimum(_TILT_PER_FRICTION * friction, _LARGEST_TILT)
        tilted = normal * (1.0 + tilt * (self._side_x * shear.real + self._side_y * shear.imag))
        pulled = normal * friction * (self._shear_x * shear.real + self._shear_y * shear.imag)
        relaxed = self._relaxed.at(time_s, np.zeros(time_s.shape[1], dtype=np.int64))
        return np.where(self._tangential, pulled, tilted), relaxed

    def state(self, time_s: FloatArray) -> ContactState:
        """Truth at instants (n,); slip is prescribed, of the whole contact at once."""
        state = self._motion.at(time_s)
        angle = np.deg2rad(state.direction_deg)
        place_mm = self._taxel_mm + state.travel_mm[:, None]
        friction, ripple = self._friction_and_ripple(time_s[:, None], place_mm)
        normal = state.load_n[:, None] * self._taxel_share * (1 + ripple)
        shear = _pairs(state.shear)
        slips = (state.speed_mm_s > 0).astype(np.float64)
        return ContactState(
            normal_n=normal,
            tangential_n=-normal[..., None] * (friction[..., None] * shear[:, None, :]),
            slipping=np.repeat(slips[:, None], normal.shape[1], axis=1),
            slipping_share=slips,
            load_n=state.load_n,
            travel_mm=_pairs(state.travel_mm),
            velocity_mm_s=state.speed_mm_s[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1),
        )

    def _friction_and_ripple(
        self, time_s: FloatArray, place_mm: ComplexArray
    ) -> tuple[FloatArray, FloatArray]:
        """Friction coefficient and groove ripple at places (x + iy) over the surface."""
        friction, ripple = np.zeros(place_mm.shape), np.zeros(place_mm.shape)
        for number, surface in enumerate(self._motion.surfaces):
            share = self._motion.surface_share(number, time_s)
            factor = friction_factor(surface.unevenness, _pairs(place_mm))
            friction += share * surface.friction * factor
            if isinstance(surface, GroovedPlate):
                ripple += share * _ripple(surface, place_mm)
        return friction, ripple


def _pairs(vectors: ComplexArray) -> FloatArray:
    """Pairs (..., 2) of x and y."""
    return np.stack([vectors.real, vectors.imag], axis=-1)


def _ripple(grooves: GroovedPlate, place_mm: ComplexArray) -> FloatArray:
    """Relative change of the normal force at places in the frame of the surface; see `SignalContact`."""
    angle = np.deg2rad(grooves.angle_deg)
    along_mm = place_mm.real * np.cos(angle) + place_mm.imag * np.sin(angle)
    phase = 2 * np.pi * along_mm / grooves.period_mm
    aperture = np.exp(-2 * (np.pi * _APERTURE_SD_MM / grooves.period_mm) ** 2)
    amplitude = grooves.ripple * np.cos(np.deg2rad(grooves.angle_deg)) * aperture
    wave = np.cos(phase)
    for order, part in enumerate(_HARMONICS, start=2):
        wave = wave + part * np.cos(order * phase)
    return np.asarray(amplitude * wave)


def _shares(rng: np.random.Generator, group: NDArray[np.int64]) -> FloatArray:
    """Draw unequal shares that add up to 1 in each group."""
    raw = 1 + INEQUALITY * rng.uniform(-1, 1, len(group))
    totals = np.bincount(group, raw) if len(group) else np.zeros(0)
    return np.asarray(raw / totals[group])
