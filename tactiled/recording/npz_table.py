"""Tables as npz: an array of times and one of readings, or of readings alone."""

import io
import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO

import numpy as np

from tactiled.array import FloatArray
from tactiled.errors import ConfigError, DataError
from tactiled.recording.table_times import (
    OPTION_ADVICE,
    TIME_ADVICE,
    TableOptions,
    Times,
    check_size,
    find_times,
    unit_of,
)

# An array of 4096 taxels with four sides has them.
MOST_CHANNELS = 4 * 4096
_MOST_HEADER_BYTES = 10_000  # of an array: a hundred are enough, and numpy would read 4 GB
_READ_VALUES = 1 << 16  # at once: zlib holds twice what it is asked for


def read_npz(path: Path, options: TableOptions) -> tuple[Times, FloatArray | None, FloatArray]:
    """Read the times, None where a rate stands for them, and the readings (n, channels); see `read_table`."""
    if options.columns:
        raise ConfigError("command line", ["--columns is for CSV; an npz file has the array volts"])
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise DataError(f"{path}: not a complete npz file; write one with numpy.savez")
            with zipfile.ZipFile(stream) as archive:
                return _from_archive(path, archive, options)
    except ValueError:  # of numpy, on a header; its message may suggest unpickling, which is unsafe
        raise DataError(f"{path}: time_s and volts must be arrays of numbers") from None
    except (
        OSError,
        TypeError,
        EOFError,
        NotImplementedError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
        tokenize.TokenError,  # of numpy, on a header of brackets
    ) as error:
        raise DataError(f"{path}: cannot be read as npz: {error}") from None


def _from_archive(
    path: Path, archive: zipfile.ZipFile, options: TableOptions
) -> tuple[Times, FloatArray | None, FloatArray]:
    names = [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]
    times = find_times(path, names, options)
    others = [name for name in names if unit_of(name) is None and name != "valid"]
    name = "volts" if "volts" in names else others[0] if len(others) == 1 else None
    if times is None or name is None:
        missing = [*(["time_s"] if times is None else []), *(["volts"] if name is None else [])]
        advice = f"; {TIME_ADVICE}{OPTION_ADVICE}" if times is None else ""
        raise DataError(f"{path}: lacks the array {' and '.join(missing)}; it has {names}{advice}")
    readings = _read_array(path, archive, name)
    n_channels = math.prod(readings.shape[1:])
    if not 0 < n_channels <= MOST_CHANNELS:  # rows without a channel cost no bytes: there may be any number
        raise DataError(f"{path}: {name} has {n_channels} channels; 1 to {MOST_CHANNELS} are read")
    stamps = [_read_array(path, archive, used) for used in times.used]
    if readings.ndim < 2 or any(stamp.shape != readings.shape[:1] for stamp in stamps):
        shapes = " and ".join(f"{used} {stamp.shape}" for used, stamp in zip(times.used, stamps, strict=True))
        raise DataError(
            f"{path}: {shapes}{' and ' if shapes else ''}{name} {readings.shape} should be (n,) "
            "and (n, channels)"
        )
    if "valid" in names:  # written by `calibrate --guide`: invalid readings become NaN
        valid = _read_array(path, archive, "valid")
        if valid.shape != readings.shape:
            raise DataError(f"{path}: valid {valid.shape} should have the shape of {name} {readings.shape}")
        readings[valid == 0] = np.nan
    return times, times.seconds(path, stamps) if stamps else None, readings.reshape(-1, n_channels)


def _read_array(path: Path, archive: zipfile.ZipFile, name: str) -> FloatArray:
    """Read an array of numbers; refuse it by its header where it claims too much."""
    if archive.getinfo(f"{name}.npy").compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise DataError(f"{path}: {name} is compressed as numpy compresses nothing; write it by numpy.savez")
    with archive.open(f"{name}.npy") as stream:
        shape, is_fortran, dtype = _npy_header(stream)
        if not np.can_cast(dtype, np.float64, "same_kind") or any(length < 0 for length in shape):
            raise DataError(f"{path}: time_s and volts must be arrays of numbers")
        check_size(path, math.prod(shape) * max(8, dtype.itemsize))
        whole = np.empty(math.prod(shape))
        for at in range(0, whole.size, _READ_VALUES):
            part = whole[at : at + _READ_VALUES]
            data = stream.read(part.size * dtype.itemsize)
            if len(data) < part.size * dtype.itemsize:
                raise EOFError("an array ends before the shape that it claims")
            part[:] = np.frombuffer(data, dtype)
        if stream.read(1):  # at the end, zipfile compares the checksum
            raise zipfile.BadZipFile("an array has more bytes than the shape that it claims")
    return whole.reshape(shape, order="F" if is_fortran else "C")


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[np.generic]]:
    version = np.lib.format.read_magic(stream)
    is_first = version == (1, 0)
    length = stream.read(2 if is_first else 4)
    if (n_bytes := int.from_bytes(length, "little")) > _MOST_HEADER_BYTES:
        raise ValueError(f"the header of an array claims {n_bytes} bytes")
    header = io.BytesIO(length + stream.read(n_bytes))
    read = np.lib.format.read_array_header_1_0 if is_first else np.lib.format.read_array_header_2_0
    shape, is_fortran, dtype = read(header)
    return tuple(int(length) for length in shape), bool(is_fortran), dtype
