"""Conversion of a scene's load and plates to single taxels, and of forces on taxels to channels."""

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics.base import BUMP_MM, Surface, TaxelForces
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.phases import FlatPlate, GroovedPlate
from tactiled.errors import ConfigError

# Relative spread of the load between taxels, and between the areas of one taxel, of a hand-made array.
INEQUALITY = 0.05
_PLATE_MM = 100.0  # a scene touches an uneven plate within so much of its middle: ten of its longest waves


class ChannelForces:
    """Conversion of forces on the bumps to forces on the channels.

    A side channel reads the area `area` (channels,) of those at `azimuth_deg`, times its `gain` (channels,).
    """

    def __init__(self, motion: SceneMotion, array: Array) -> None:
        kinds = np.array(array.channel_kind)
        side = kinds == "side"
        azimuths = array.azimuth_deg[side] % 360
        self.azimuth_deg: FloatArray = np.unique(azimuths)
        self._taxel = array.channel_taxel
        self.area = np.zeros(array.n_channels, dtype=np.int64)
        self.area[side] = np.searchsorted(self.azimuth_deg, azimuths)
        self._is_side, self._is_normal = side, kinds == "normal"
        # Friction on a skin that slides along +x points along -x; the channel rises (array file).
        self._shear_x = -array.sign * (kinds == "shear_x")
        self._shear_y = -array.sign * (kinds == "shear_y")
        rng = np.random.default_rng([motion.scene.seed, 2])
        self.gain = np.where(side, 1 + INEQUALITY * rng.uniform(-1, 1, array.n_channels), 1.0)

    def channels(self, felt: TaxelForces) -> FloatArray:
        """(n, channels)."""
        taxel = self._taxel
        out = self._is_normal * felt.normal_n[:, taxel]
        if felt.side_n.shape[-1]:
            out = out + self._is_side * self.gain * felt.side_n[:, taxel, self.area]
        tangential = felt.tangential_n[:, taxel]
        return np.asarray(out + self._shear_x * tangential[..., 0] + self._shear_y * tangential[..., 1])


def taxel_shares(motion: SceneMotion, array: Array) -> FloatArray:
    """Share of the load on each taxel; the sum is 1.

    `ConfigError` where no taxel carries load, or `Scene.touching` names one that does not exist.
    """
    scene = motion.scene
    source = f"scene {scene.name}"
    if outside := [t for t in scene.touching if not 0 <= t < array.n_taxels]:
        raise ConfigError(source, [f"touching: {outside} are not among the {array.n_taxels} taxels"])
    rng = np.random.default_rng([scene.seed, 1])
    share = 1 + INEQUALITY * rng.uniform(-1, 1, array.n_taxels)
    along_x, along_y = scene.load_gradient_per_mm
    tilt = 1 + along_x * (array.x_mm - array.x_mm.mean()) + along_y * (array.y_mm - array.y_mm.mean())
    share *= np.maximum(tilt, 0.0)
    if scene.touching:
        share *= np.isin(np.arange(array.n_taxels), scene.touching)
    if share.sum() <= 0:
        raise ConfigError(source, ["touching, load_gradient_per_mm: no taxel is left to carry the load"])
    return np.asarray(share / share.sum())


def model_surface(plate: FlatPlate | GroovedPlate) -> Surface:
    """Convert a scene's plate for a contact model; `ConfigError` for grooves as deep as the bump is high."""
    common = plate.model_dump(include={"friction", "static_ratio", "stribeck_mm_s", "unevenness"})
    if isinstance(plate, FlatPlate):
        return Surface(**common)
    if plate.depth_mm >= BUMP_MM:
        fault = (
            f"surface.depth_mm: {plate.depth_mm:g} mm is as deep as the bump is high ({BUMP_MM:g} mm); "
            "no contact model is valid there; use shallower grooves"
        )
        raise ConfigError("scene", [fault])
    return Surface(period_mm=plate.period_mm, angle_deg=plate.angle_deg, depth_mm=plate.depth_mm, **common)


def offset_mm(plate: FlatPlate | GroovedPlate, seed: int) -> FloatArray:
    """Offset (2,) of the plate: each scene touches an uneven one at another place, by its seed."""
    if isinstance(plate, FlatPlate) and plate.unevenness:
        return np.random.default_rng([seed, 4]).uniform(-_PLATE_MM, _PLATE_MM, 2)
    return np.zeros(2)
