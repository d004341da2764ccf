"""Compiled path of a scan: the functions of `compiled.c`, where an installation had a C compiler.

Classes that have a compiled way beside their numpy one ask `library` for it when they are made. Both ways
give the same bits. `hatch_build.py` builds the library. The hash of `compiled.c` in it must be that of the
file beside this module: a stale library is not used. ``TACTILED_COMPILED=0`` in the environment forces numpy.
"""

import ctypes
import hashlib
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

SOURCE = Path(__file__).with_name("compiled.c")
LIBRARY = Path(__file__).with_name("_compiled.so")
SETTING = "TACTILED_COMPILED"
_SIZE, _POINTER, _REAL, _INT = ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_double, ctypes.c_int
# Results and arguments as `compiled.c` declares them.
_DECLARED: dict[str, tuple[Any, list[Any]]] = {
    "frames": (_SIZE, [ctypes.c_char_p, _SIZE, _SIZE, _INT, _INT, _POINTER, _POINTER, _SIZE]),
    "hold": (_INT, [_SIZE] * 2 + [_POINTER] * 2 + [_REAL] * 2 + [_POINTER] * 3),
    "bank": (None, [_SIZE] * 2 + [_POINTER, _SIZE] + [_POINTER] * 3),
    "contact": (None, [_SIZE] * 5 + [_POINTER] * 10 + [_INT] + [_REAL] * 4 + [_POINTER] * 7),
    "stuck": (_INT, [_SIZE] * 4 + [_POINTER] * 4 + [_REAL] + [_SIZE] * 2 + [_REAL] + [_POINTER] * 10),
    "clean": (_INT, [_SIZE] * 5 + [_POINTER] * 4),
    "respond": (None, [_SIZE] * 2 + [_POINTER] * 2 + [_REAL] + [_POINTER] * 2),
    "evidence": (
        None,
        [_SIZE, _POINTER, _SIZE, _POINTER, _POINTER, _SIZE, _POINTER] + [_REAL] * 5 + [_POINTER] * 4,
    ),
}


class CompiledPath(NamedTuple):
    """Functions of the library, or the reason why there are none.

    Attributes
    ----------
    functions : ctypes.CDLL or None
    reason : str
        Empty where the library is in use.
    """

    functions: ctypes.CDLL | None
    reason: str

    @property
    def words(self) -> str:
        """Path that a scan takes, in words."""
        return "compiled" if self.functions is not None else f"numpy ({self.reason})"


def load(library: Path = LIBRARY, source: Path = SOURCE) -> CompiledPath:
    """Load a library that was built from a source file."""
    if os.environ.get(SETTING, "1") == "0":
        return CompiledPath(None, f"{SETTING}=0")
    if not library.exists():
        return CompiledPath(None, "built without a C compiler")
    try:
        functions = ctypes.CDLL(str(library))
        functions.tactiled_source.restype = ctypes.c_char_p
        if functions.tactiled_source().decode() != source_hash(source):
            return CompiledPath(None, f"{library.name} was built from another {source.name}: install again")
        for name, (result, arguments) in _DECLARED.items():
            function = getattr(functions, f"tactiled_{name}")
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        return CompiledPath(None, f"{library.name} does not load: {error}")
    return CompiledPath(functions, "")


def source_hash(source: Path = SOURCE) -> str:
    """Return the hash by which a library names its source."""
    return hashlib.sha256(source.read_bytes()).hexdigest()


path = load()
"""What was loaded with this module."""


def library() -> Any | None:
    """Return the functions for an object that is being made, or None for numpy."""
    return path.functions


def address(array: NDArray[Any]) -> int:
    """Return the address of the first element of a dense array, which the caller keeps alive."""
    where: int = array.__array_interface__["data"][0]
    return where


def dense(array: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
    """Return the array itself where it is dense and of a type, else a copy."""
    return np.ascontiguousarray(array, dtype=dtype)
