"""Geometry of a tactile array: positions of the taxels, and quantities that channels measure.

Array frame: x along columns, y along rows, millimetres; azimuths and directions from +x towards +y.
A ``side`` channel sits under one side of its taxel. Sliding the skin along +x loads the trailing side,
so a side channel at azimuth phi answers motion along direction theta as ``-cos(theta - phi)``:
R1 (180 degrees) rises and R3 (0 degrees) falls. A ``shear_x`` channel rises when the skin slides
along +x, ``shear_y`` along +y (``sign = -1`` turns one round), ``normal`` with pressure. The array file of a
pad that is mounted at an angle has the direction of the pad's own x axis (``axes_deg``).

Readings are in the array's own ``unit`` and within its ``range``; its ``zero`` are the readings without load.
"""

import functools
import itertools
import os
import platform
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from threadpoolctl import threadpool_info, threadpool_limits

from tactiled import tomlfile, tomltext
from tactiled.tomlfile import Params

# One thread of BLAS, here, because every module with numerics imports this one first. A product that threads
# divide between them is rounded in another order, so events would differ between hosts with different numbers
# of cores; and matrices of 36 channels are too small for two. The call limits libraries that are loaded
# already, as numpy's may be in a program that uses tactiled as a library; the variables are for those that
# come later (scipy has a BLAS of its own) and for processes that are started.
threadpool_limits(limits=1, user_api="blas")
os.environ.update(OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

FloatArray = NDArray[np.float64]


def numerics_words() -> str:
    """Return the libraries here and the kind of processor that BLAS found, on which last bits depend."""
    # scipy may have brought another BLAS, and libraries are listed by their random addresses.
    blas = min(
        (found for found in threadpool_info() if found["user_api"] == "blas"),
        key=lambda found: "numpy" not in Path(found["filepath"]).parent.name,
        default=None,
    )
    words = [f"Python {platform.python_version()}", f"numpy {np.__version__}"]
    if blas:
        processor = blas.get("architecture", "any processor")
        words.append(f"{blas['internal_api']} {blas['version']} for {processor}")
    return ", ".join([*words, os.confstr("CS_GNU_LIBC_VERSION") or "no glibc", platform.machine()])


Kind = Literal["side", "normal", "shear_x", "shear_y"]
Unit = Literal["V", "count", "N", "uT", "kPa"]
_DEFAULT_RANGE = (-8.0, 8.0)  # volts: beyond the reference of every common converter
_FIRST = re.compile(r"first (\d+(?:\.\d+)?) s")
_LONGEST_FIRST_S = 60.0  # these scans are kept in memory
_SMALLEST, _LARGEST = 1e-6, 1e9  # range in its unit, within which squares and fourth powers are exact enough
# A hundred times the largest array that is known; what is made of an array grows with their product.
_MOST_TAXELS, _MOST_CHANNELS = 4096, 4 * 4096
_OWN_AZIMUTH_DEG = {"shear_x": 0.0, "shear_y": 90.0, "normal": float("nan")}
_AXES_DEG = Field(
    default=0.0, ge=-360, le=360, description="direction of the pad's own x axis; turns channels, not places"
)
_MIRRORED = Field(
    default=None,
    description="own axis of the pad that is reversed: of two pads that face each other, one is a mirror "
    "image",
)


# A robot's whole skin; squares of such places are exact enough.
_PlaceMm = Annotated[float, Field(ge=-1e5, le=1e5)]


class Grid(Params):
    """Pad with taxels at every (x, y), numbered row by row."""

    x_mm: list[_PlaceMm] = Field(min_length=1, max_length=256, description="places of the columns")
    y_mm: list[_PlaceMm] = Field(min_length=1, max_length=256, description="places of the rows")
    axes_deg: float = _AXES_DEG
    mirrored: Literal["x", "y"] | None = _MIRRORED

    @model_validator(mode="after")
    def _increasing(self) -> Self:
        for name, places in (("x_mm", self.x_mm), ("y_mm", self.y_mm)):
            if any(b <= a for a, b in itertools.pairwise(places)):
                raise ValueError(f"{name} must grow from entry to entry")
        return self


class TaxelPlace(Params):
    """Position of a taxel that is in no grid."""

    x_mm: _PlaceMm
    y_mm: _PlaceMm
    pad: int = Field(default=0, ge=0, description="taxels of one rigid pad share a number")
    axes_deg: float = _AXES_DEG
    mirrored: Literal["x", "y"] | None = _MIRRORED


class ContactLevels(Params):
    """Pressure responses that mean contact, in the unit of the array."""

    above: float = Field(gt=0, description="pressure response of a taxel in contact")
    below: float = Field(gt=0, description="contact is lost when every taxel is below")
    loading_per_s: float = Field(gt=0, description="pressure response that rises faster is loading")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.below > self.above:
            raise ValueError(f"below is {self.below:g}, which is more than above, {self.above:g}")
        return self


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

    name: str = Field(
        min_length=1,
        max_length=24,
        pattern=r"^[^\x00-\x1f\x7f-\x9f]+$",
        description="as the board's hello says it",
    )
    description: str = ""
    unit: Unit = Field(default="V", description="unit of the readings")
    range: tuple[float, float] | None = Field(
        default=None, description="lowest and highest reading, in unit; -8 to 8 where that is V"
    )
    zero: float | list[float] | str = Field(
        default=0.0,
        description="readings without a load: one number, one for each channel, or 'first 0.3 s' of the data",
    )
    shear_per_friction: float | None = Field(
        default=None,
        gt=0,
        description="reading of shear over reading of pressure where tangential and normal load are equal; "
        "left out: 1, which slip detection trusts less where shear has channels of its own in counts",
    )
    contact: ContactLevels | None = Field(
        default=None, description="left out: from the noise and the range of the channels"
    )
    grids: list[Grid] = []
    taxels: list[TaxelPlace] = []
    taxel_count: int | None = Field(
        default=None, ge=1, le=_MOST_TAXELS, description="taxels whose places are unknown"
    )
    taxel_channels: list[TaxelChannel] = Field(default=[], description="the same for every taxel")
    channels: list[Channel] = Field(default=[], description="or each channel, in wire order")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if bool(self.grids) + bool(self.taxels) + (self.taxel_count is not None) != 1:
            raise ValueError(
                "give either [[grids]] or [[taxels]], or taxel_count where the places are not known"
            )
        if bool(self.taxel_channels) == bool(self.channels):
            raise ValueError("give either [[taxel_channels]] or [[channels]]")
        if self.n_taxels > _MOST_TAXELS or self.n_channels > _MOST_CHANNELS:
            raise ValueError(
                f"{self.n_taxels} taxels and {self.n_channels} channels; at most {_MOST_TAXELS} and "
                f"{_MOST_CHANNELS} are possible"
            )
        for index, channel in enumerate(self.channels):
            if channel.taxel >= self.n_taxels:
                raise ValueError(
                    f"channels[{index}].taxel is {channel.taxel}, but there are {self.n_taxels} taxels"
                )
        return self

    @model_validator(mode="after")
    def _readings(self) -> Self:
        if self.unit != "V" and self.range is None:
            raise ValueError(
                f"range is missing: with unit = '{self.unit}', give the lowest and highest reading, "
                "as in range = [0, 65535]"
            )
        low, high = self.limits
        if not _SMALLEST <= high - low <= 2 * _LARGEST:
            raise ValueError(
                f"range is [{low:g}, {high:g}]; the second number must be larger, "
                f"by {_SMALLEST:g} to {2 * _LARGEST:g}"
            )
        if isinstance(self.zero, str):
            first = _FIRST.fullmatch(self.zero)
            if first is None or not 0 < float(first[1]) <= _LONGEST_FIRST_S:
                raise ValueError(
                    f"zero is '{self.zero}'; give a number, a list, or 'first 0.3 s' "
                    f"(up to {_LONGEST_FIRST_S:g} s)"
                )
            return self
        zeros = self.zero if isinstance(self.zero, list) else [self.zero]
        if isinstance(self.zero, list) and len(zeros) != self.n_channels:
            raise ValueError(f"zero has {len(zeros)} numbers, but there are {self.n_channels} channels")
        for zero in zeros:
            if not low <= zero <= high:
                raise ValueError(f"zero is {zero:g}, outside the range [{low:g}, {high:g}]")
        return self

    @property
    def n_taxels(self) -> int:
        """Number of taxels."""
        in_grids = sum(len(g.x_mm) * len(g.y_mm) for g in self.grids)
        return in_grids or len(self.taxels) or self.taxel_count or 0

    @property
    def n_channels(self) -> int:
        """Number of channels."""
        return len(self.channels) or self.n_taxels * len(self.taxel_channels)

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest reading."""
        return _DEFAULT_RANGE if self.range is None else self.range


@dataclass(frozen=True, eq=False)
class Array:
    """Tactile array."""

    name: str
    # x_mm, y_mm: (taxels,)
    x_mm: FloatArray
    y_mm: FloatArray
    pad: NDArray[np.int64]  # (taxels,): number of the rigid pad that a taxel belongs to
    channel_taxel: NDArray[np.int64]  # (channels,)
    channel_kind: tuple[Kind, ...]  # one for each channel
    channel_name: tuple[str, ...]  # one for each channel
    # (channels,): place of a side channel around its taxel; direction of motion that raises a shear channel
    # (before its sign); NaN for a normal channel
    azimuth_deg: FloatArray
    sign: FloatArray  # (channels,)
    has_places: bool  # False where the places are not known; they are then all 0
    unit: Unit
    # low, high: limits of the readings; `high` itself is a saturated reading of a channel that rises under
    # load
    low: float
    high: float
    zero: FloatArray  # (channels,): readings without a load
    zero_first_s: float  # time at the beginning of the data whose mean is the zero instead; 0 for none
    # Reading of shear over reading of pressure where tangential and normal load are equal
    shear_per_friction: float
    is_shear_scaled: bool  # False for chips in counts whose file does not state it: it may be off by far
    contact: ContactLevels | None  # None where noise and range of the channels decide

    @property
    def full_scale(self) -> float:
        """Largest size of a reading relative to its zero, in `unit`; it sets the grid of exact sums."""
        if self.zero_first_s or self.zero.any():
            return self.high - self.low
        return max(abs(self.low), abs(self.high))

    def in_range(self, readings: FloatArray) -> NDArray[np.bool_]:
        """Return True for readings that are neither saturated nor NaN.

        The lowest reading counts: unloaded taxels of many sensors read exactly 0. So does the highest of
        channels that fall under load, which read that without one.
        """
        is_rest = self.falls_under_load & (readings == self.high)
        return np.asarray((readings >= self.low) & (readings < self.high) | is_rest)

    @functools.cached_property
    def falls_under_load(self) -> NDArray[np.bool_]:
        """True for the channels (channels,) whose readings fall under load; a field may move either way."""
        loads = np.array([kind in ("normal", "side") for kind in self.channel_kind])
        return np.asarray(loads & (self.sign < 0) & (self.unit != "uT"))

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

    @property
    def is_field(self) -> bool:
        """True for magnetic fields along axes; the sum of sides in uT is all that presses, a pressure."""
        return self.unit == "uT" and any(kind.startswith("shear") for kind in self.channel_kind)

    @property
    def measures_ratio(self) -> bool:
        """True where the array measures shear over load; a magnetic field along z is no load."""
        return self.has_shear and bool(self.normal_weights().any()) and not self.is_field

    def in_words(self) -> str:
        """Return one line on taxels, channels and missing capabilities."""
        pads = len(set(self.pad.tolist()))
        where = f"on {pads} pad{'s' * (pads > 1)}" if self.has_places else "at unknown places"
        words = (
            f"array {self.name}: {self.n_taxels} taxels {where}, "
            f"{self.n_channels} channels ({', '.join(sorted(set(self.channel_kind)))}), "
            f"{self.low:g} to {self.high:g} {self.unit}"
        )
        return words if self.has_shear else f"{words}, no shear channels: directions cannot be estimated"

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
        # A side channel rises where motion comes from.
        feels_along = np.where(np.array(self.channel_kind) == "side", -1.0, 1.0)
        feels_along[np.isnan(self.azimuth_deg)] = 0.0
        azimuth = np.deg2rad(np.nan_to_num(self.azimuth_deg))
        # cos(90 deg) is 6e-17 in floating point; rounding makes such weights exactly zero.
        weights[0, self.channel_taxel, channels] = feels_along * np.cos(azimuth).round(15)
        weights[1, self.channel_taxel, channels] = feels_along * np.sin(azimuth).round(15)
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
    unknown = [TaxelPlace(x_mm=0.0, y_mm=0.0)] * (file.taxel_count or 0)
    taxels = (
        file.taxels
        or unknown
        or [
            TaxelPlace(x_mm=x, y_mm=y, pad=pad, axes_deg=grid.axes_deg, mirrored=grid.mirrored)
            for pad, grid in enumerate(file.grids)
            for y in grid.y_mm
            for x in grid.x_mm
        ]
    )
    channels = file.channels or [
        Channel(taxel=taxel, **template.model_dump())
        for taxel in range(len(taxels))
        for template in file.taxel_channels
    ]
    taxel = np.array([c.taxel for c in channels], dtype=np.int64)
    azimuth_deg = np.array([_azimuth_deg(channel, taxels[channel.taxel]) for channel in channels])
    low, high = file.limits
    first = _FIRST.fullmatch(file.zero) if isinstance(file.zero, str) else None
    return Array(
        name=file.name,
        x_mm=np.array([t.x_mm for t in taxels]),
        y_mm=np.array([t.y_mm for t in taxels]),
        pad=np.array([t.pad for t in taxels], dtype=np.int64),
        channel_taxel=taxel,
        channel_kind=tuple(c.kind for c in channels),
        channel_name=tuple(f"t{c.taxel}.{c.name}" for c in channels),
        azimuth_deg=azimuth_deg % 360.0,
        sign=np.array([float(c.sign) for c in channels]),
        has_places=file.taxel_count is None,
        unit=file.unit,
        low=low,
        high=high,
        zero=np.full(len(channels), 0.0 if isinstance(file.zero, str) else file.zero),
        zero_first_s=0.0 if first is None else float(first[1]),
        shear_per_friction=1.0 if file.shear_per_friction is None else file.shear_per_friction,
        is_shear_scaled=file.shear_per_friction is not None or not _in_counts(file.unit, channels),
        contact=file.contact,
    )


def _in_counts(unit: Unit, channels: Sequence[Channel]) -> bool:
    """Return True where shear has channels of its own in counts, as of chips with unequal axes."""
    return unit == "count" and any(channel.kind.startswith("shear") for channel in channels)


def _azimuth_deg(channel: Channel, place: TaxelPlace) -> float:
    """Azimuth of a channel in the axes of the array; NaN for a normal channel."""
    own_deg = _OWN_AZIMUTH_DEG.get(channel.kind, channel.azimuth_deg)
    assert own_deg is not None  # as TaxelChannel checks
    reversed_deg = {None: own_deg, "x": 180.0 - own_deg, "y": -own_deg}[place.mirrored]
    return reversed_deg + place.axes_deg


def load_array(name_or_path: str) -> Array:
    """Load an array by shipped name (``wang2019-3x3``) or by path; `ConfigError` lists every fault."""
    return build(tomlfile.load(tomltext.locate(name_or_path, "config/arrays"), ArrayFile))
