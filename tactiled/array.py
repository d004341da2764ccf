"""Geometry of a tactile array: positions of the taxels, and quantities that channels measure.

Array frame: x along columns, y along rows, millimetres; azimuths and directions from +x towards +y.
A ``side`` channel sits under one side of its taxel. Sliding the skin along +x loads the trailing side,
so a side channel at azimuth phi answers motion along direction theta as ``-cos(theta - phi)``:
R1 (180 degrees) rises and R3 (0 degrees) falls. A ``shear_x`` channel rises when the skin slides
along +x, ``shear_y`` along +y (``sign = -1`` turns one round), ``normal`` with pressure.
"""

import itertools
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from tactiled import blas, tomlfile, tomltext
from tactiled.tomlfile import Params

blas.use_one_thread()  # here, because every module with numerics imports this one first

FloatArray = NDArray[np.float64]
Kind = Literal["side", "normal", "shear_x", "shear_y"]


class Grid(Params):
    """Pad with taxels at every (x, y), numbered row by row."""

    x_mm: list[float] = Field(min_length=1, description="places of the columns")
    y_mm: list[float] = Field(min_length=1, description="places of the rows")

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        for name, places in (("x_mm", self.x_mm), ("y_mm", self.y_mm)):
            if any(b <= a for a, b in itertools.pairwise(places)):
                raise ValueError(f"{name} must grow from entry to entry")
        return self


class TaxelPlace(Params):
    """Position of a taxel that is in no grid."""

    x_mm: float
    y_mm: float
    pad: int = Field(default=0, ge=0, description="taxels of one rigid pad share a number")


class TaxelChannel(Params):
    """Quantity that one channel measures."""

    name: str = Field(min_length=1)
    kind: Kind
    azimuth_deg: float | None = Field(default=None, description="of a side channel, from +x towards +y")
    sign: Literal[-1, 1] = 1

    @model_validator(mode="after")
    def _azimuth(self) -> Self:
        if (self.kind == "side") != (self.azimuth_deg is not None):
            raise ValueError("azimuth_deg belongs to kind = 'side', and to no other kind")
        return self


class Channel(TaxelChannel):
    """Channel of an individual list, with the taxel that it belongs to."""

    taxel: int = Field(ge=0)


class ArrayFile(Params):
    """Schema of ``config/arrays/*.toml``."""

    name: str = Field(min_length=1, max_length=24, description="as the board's hello says it")
    description: str = ""
    grids: list[Grid] = []
    taxels: list[TaxelPlace] = []
    taxel_channels: list[TaxelChannel] = Field(default=[], description="the same for every taxel")
    channels: list[Channel] = Field(default=[], description="or each channel, in wire order")
    full_scale_volts: float = Field(default=8.0, gt=0, description="no reading is larger than this")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if bool(self.grids) == bool(self.taxels):
            raise ValueError("give either [[grids]] or [[taxels]]")
        if bool(self.taxel_channels) == bool(self.channels):
            raise ValueError("give either [[taxel_channels]] or [[channels]]")
        n_taxels = sum(len(g.x_mm) * len(g.y_mm) for g in self.grids) or len(self.taxels)
        for index, channel in enumerate(self.channels):
            if channel.taxel >= n_taxels:
                raise ValueError(
                    f"channels[{index}].taxel is {channel.taxel}, but there are {n_taxels} taxels"
                )
        return self


@dataclass(frozen=True, eq=False)
class Array:
    """Tactile array.

    Attributes
    ----------
    name : str
    x_mm, y_mm : (taxels,) float64
    pad : (taxels,) int64
        Number of the rigid pad that a taxel belongs to.
    channel_taxel : (channels,) int64
    channel_kind : tuple of str, one for each channel
    channel_name : tuple of str, one for each channel
    azimuth_deg : (channels,) float64
        NaN where the channel is not a side channel.
    sign : (channels,) float64
    full_scale_volts : float
        Upper limit of readings; sets the grid on which sums are exact.
    """

    name: str
    x_mm: FloatArray
    y_mm: FloatArray
    pad: NDArray[np.int64]
    channel_taxel: NDArray[np.int64]
    channel_kind: tuple[Kind, ...]
    channel_name: tuple[str, ...]
    azimuth_deg: FloatArray
    sign: FloatArray
    full_scale_volts: float

    @property
    def n_taxels(self) -> int:
        """Number of taxels."""
        return len(self.x_mm)

    @property
    def n_channels(self) -> int:
        """Number of channels."""
        return len(self.channel_taxel)

    @property
    def has_shear(self) -> bool:
        """True when some channel responds to shear, so that directions can be estimated."""
        return bool(np.any(self.shear_weights() != 0))

    def summary(self) -> dict[str, Any]:
        """Return a plain map for `tactiled check-config`."""
        return {
            "array": self.name,
            "taxels": self.n_taxels,
            "pads": len(set(self.pad.tolist())),
            "channels": self.n_channels,
            "kinds": sorted(set(self.channel_kind)),
            "x_mm": self.x_mm.tolist(),
            "y_mm": self.y_mm.tolist(),
            "channel_names": list(self.channel_name),
            "full_scale_volts": self.full_scale_volts,
        }

    def in_words(self) -> str:
        """Return one line on taxels, channels and missing capabilities."""
        pads = len(set(self.pad.tolist()))
        words = (
            f"array {self.name}: {self.n_taxels} taxels on {pads} pad{'s' * (pads > 1)}, "
            f"{self.n_channels} channels ({', '.join(sorted(set(self.channel_kind)))})"
        )
        return words if self.has_shear else f"{words}, no shear channels: directions cannot be told"

    def shear_weights(self) -> NDArray[np.float64]:
        """Return the weights that convert channels to the motion response of each taxel.

        Returns
        -------
        (2, taxels, channels) float64
            ``weights @ volts`` is volts along (x, y); positive means motion of the skin along +x (+y).
            For the four resistors this is (R1 - R3, R2 - R4): the pair signature of the 2019 paper.
        """
        weights = np.zeros((2, self.n_taxels, self.n_channels))
        channels = np.arange(self.n_channels)
        kinds = np.array(self.channel_kind)
        side = kinds == "side"
        azimuth = np.deg2rad(np.where(side, self.azimuth_deg, 0.0))
        # cos(90 deg) is 6e-17 in floating point; rounding makes such weights exactly zero.
        weights[0, self.channel_taxel, channels] = np.where(side, -np.cos(azimuth).round(15), 0.0)
        weights[1, self.channel_taxel, channels] = np.where(side, -np.sin(azimuth).round(15), 0.0)
        for axis, kind in enumerate(("shear_x", "shear_y")):
            weights[axis, self.channel_taxel[kinds == kind], channels[kinds == kind]] = 1.0
        return weights * self.sign + 0.0  # + 0.0 turns -0 into 0

    def normal_weights(self) -> NDArray[np.float64]:
        """Return the weights that convert channels to the pressure response of each taxel.

        Returns
        -------
        (taxels, channels) float64
            Mean of the normal channels of the taxel, or of its side channels when it has none.
        """
        weights = np.zeros((self.n_taxels, self.n_channels))
        kinds = np.array(self.channel_kind)
        for taxel in range(self.n_taxels):
            mine = self.channel_taxel == taxel
            chosen = mine & (kinds == "normal")
            if not chosen.any():
                chosen = mine & (kinds == "side")
            if chosen.any():
                weights[taxel, chosen] = self.sign[chosen] / chosen.sum()
        return weights

    def columns(self) -> list[list[int]]:
        """Return the taxels of each column (one pad, one x) in ascending y; only columns of two or more."""
        return self._lines(self.x_mm, self.y_mm)

    def rows(self) -> list[list[int]]:
        """Return the taxels of each row (one pad, one y) in ascending x; only rows of two or more."""
        return self._lines(self.y_mm, self.x_mm)

    def _lines(self, across: FloatArray, along: FloatArray) -> list[list[int]]:
        lines: dict[tuple[int, float], list[int]] = {}
        for taxel in np.argsort(along, kind="stable"):
            key = (int(self.pad[taxel]), round(float(across[taxel]), 6))
            lines.setdefault(key, []).append(int(taxel))
        return [line for _, line in sorted(lines.items()) if len(line) > 1]


def build(file: ArrayFile) -> Array:
    """Make an array from a checked file."""
    if file.grids:
        places = [(x, y, pad) for pad, g in enumerate(file.grids) for y in g.y_mm for x in g.x_mm]
    else:
        places = [(t.x_mm, t.y_mm, t.pad) for t in file.taxels]
    channels = file.channels or [
        Channel(taxel=taxel, **template.model_dump())
        for taxel in range(len(places))
        for template in file.taxel_channels
    ]
    return Array(
        name=file.name,
        x_mm=np.array([p[0] for p in places]),
        y_mm=np.array([p[1] for p in places]),
        pad=np.array([p[2] for p in places], dtype=np.int64),
        channel_taxel=np.array([c.taxel for c in channels], dtype=np.int64),
        channel_kind=tuple(c.kind for c in channels),
        channel_name=tuple(f"t{c.taxel}.{c.name}" for c in channels),
        azimuth_deg=np.array([np.nan if c.azimuth_deg is None else c.azimuth_deg for c in channels]),
        sign=np.array([float(c.sign) for c in channels]),
        full_scale_volts=file.full_scale_volts,
    )


def load_array(name_or_path: str) -> Array:
    """Load an array by shipped name (``wang2019-3x3``) or by path of a TOML file.

    Raises
    ------
    ConfigError
        Lists every fault of the file.
    """
    return build(tomlfile.load(tomltext.locate(name_or_path, "config/arrays"), ArrayFile))
