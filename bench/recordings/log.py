"""Logs of others, and the small formats in which they are stored."""

import bz2
import csv
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from tactiled.array import FloatArray
from tactiled.errors import DataError

_PRESSED = 0.05  # of the range of the force: beyond drift and creep of the force sensor
_FREE = 0.005  # of the range of the force: between the two, a light touch is neither right nor wrong


@dataclass(frozen=True, eq=False)
class Log:
    """One log of a source."""

    name: str
    group: str  # what the log shares with others and a rule must not have seen: the object, the material
    time_s: FloatArray  # (n,)
    readings: FloatArray  # (n, channels): in the unit of the array, in the order of its channels
    label: bool = False  # what is asked of the log happens: its object slips, is tugged or is touched
    period_mm: float = 0.0  # of the grating that the sensor slides over; 0 for a surface without one
    speed_mm_s: float = 0.0
    # (n, 3): fx, fy, fz of the force sensor, newtons, at the scans; NaN for axes that it does not have
    forces: FloatArray | None = None
    # (rows, columns, first): size of each pad of taxels, and the channel of its first one
    pads: tuple[tuple[int, int, int], ...] = ()

    @property
    def is_pressed(self) -> NDArray[np.bool_]:
        """Scans (n,) at which the force is beyond a twentieth of its range."""
        return self._force_of_range > _PRESSED

    @property
    def is_free(self) -> NDArray[np.bool_]:
        """Scans (n,) at which the force is below half a percent of its range."""
        return self._force_of_range < _FREE

    @property
    def _force_of_range(self) -> FloatArray:
        assert self.forces is not None
        size = np.linalg.norm(np.nan_to_num(self.forces), axis=1)
        size -= size.min()
        return np.asarray(size / size.max())

    @property
    def step_s(self) -> float:
        """Mean time between scans."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)


def rows(path: Path, *, header: bool) -> FloatArray:
    """Read a CSV of numbers, (n, columns) float64; a cell that is no number is NaN, trailing commas go."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = [line for line in csv.reader(file) if line]
    body = lines[1:] if header else lines
    width = max(len(line) for line in body)
    if not any(line[-1].strip() for line in body if len(line) == width):
        width -= 1
    return np.array([[_number(cell) for cell in line[:width]] for line in body if len(line) >= width])


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def tensor(path: Path, channels: int) -> FloatArray:
    """Read the one float32 tensor of a file that PyTorch saved, (n, channels), without unpickling it.

    `DataError` where the file has not one block of data, or none of whole scans.
    """
    with zipfile.ZipFile(path) as file:
        blocks = [name for name in file.namelist() if name.endswith("/data/0")]
        if len(blocks) != 1:
            raise DataError(f"{path}: {len(blocks)} tensors, not one")
        data = np.frombuffer(file.read(blocks[0]), dtype="<f4")
    if data.size % channels:
        raise DataError(f"{path}: {data.size} values, which are not scans of {channels} channels")
    return data.reshape(-1, channels).astype(np.float64)


def pressure_profile(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read a pressure profile of a Weiss DSA controller: times (n,), cells (n, cells) of all its matrices.

    The file is XML under bzip2. A frame is hexadecimal, eight digits for each float32; -n stands for n zeros.
    """
    root = ElementTree.fromstring(bz2.decompress(path.read_bytes()))
    times_s, frames = [], []
    for frame in root.iter("frame"):
        packed = np.frombuffer(bytes.fromhex("".join((frame.findtext("frame_data") or "").split())), ">f4")
        lengths = np.where(packed < 0, -packed, 1).astype(np.int64)
        frames.append(np.repeat(np.maximum(packed, 0.0), lengths).astype(np.float64))
        times_s.append(float(frame.findtext("time_stamp") or "nan") / 1000.0)
    return np.array(times_s), np.array(frames)


def numbered(folder: Path, pattern: str) -> Iterator[Path]:
    """Yield files of a pattern in the order of their names, shorter names first (2 before 10)."""
    yield from sorted(folder.glob(pattern), key=lambda path: (len(path.name), path.name))
