"""Compiled path of a scan: the functions of `SOURCES`, where an installation had a C compiler.

Classes that have a compiled way beside their numpy one ask `library` for it when they are made. Both ways
give the same bits. `hatch_build.py` builds the library. The hash of the sources in it must be that of the
files beside this module: a stale library is not used. ``TACTILED_COMPILED=0`` in the environment forces
numpy.
"""

import ctypes
import hashlib
import importlib.util
import os
import sysconfig
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

_NAMES = "compiled.h", "compiled.c", "compiled_readings.c"
SOURCES = tuple(Path(__file__).with_name(name) for name in _NAMES)
LIBRARY = Path(__file__).with_name("_compiled.so")
SETTING = "TACTILED_COMPILED"
_octet_of: Callable[[Any], Any] = ctypes.c_char.from_buffer
# Results and arguments as the sources declare them: s size, p pointer, r real, i int, b bytes.
_KINDS = {
    "s": ctypes.c_ssize_t,
    "p": ctypes.c_void_p,
    "r": ctypes.c_double,
    "i": ctypes.c_int,
    "b": ctypes.c_char_p,
}
_DECLARED = {
    "scans": ("s", "ppsppbs"),
    "hold": ("i", "srrpspppp"),
    "bank": ("", "ssppspp"),
    "contact": ("", "ssssppppprrrrspppppippppppp"),
    "stuck": ("i", "sssppprssrpppppppppspp"),
    "readings": ("s", "pppppppppp"),
    "readings_take": ("", "pii"),
    "readings_rest": ("", "pr"),
    "readings_release": ("", "p"),
    "readings_interrupt": ("", "p"),
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


def load(library: Path = LIBRARY, sources: Sequence[Path] = SOURCES) -> CompiledPath:
    """Load a library that was built from source files."""
    if os.environ.get(SETTING, "1") == "0":
        return CompiledPath(None, f"{SETTING}=0")
    if not library.exists():
        return CompiledPath(None, "built without a C compiler")
    try:
        # Not CDLL, which gives the interpreter lock away at each call: a groove fit would take it, and keep
        # it for longer than any call takes.
        functions = ctypes.PyDLL(str(library))
        functions.tactiled_source.restype = ctypes.c_char_p
        if functions.tactiled_source().decode() != source_hash(sources):
            return CompiledPath(None, f"{library.name} was built from other sources: install again")
        for name, (result, arguments) in _DECLARED.items():
            function = getattr(functions, f"tactiled_{name}")
            function.restype = _KINDS.get(result)
            function.argtypes = [_KINDS[kind] for kind in arguments]
    except (OSError, AttributeError) as error:
        return CompiledPath(None, f"{library.name} does not load: {error}")
    return CompiledPath(functions, "")


def source_hash(sources: Sequence[Path] = SOURCES) -> str:
    """Return the hash by which a library names its sources."""
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()


path = load()
"""Library that was loaded with this module."""


def library() -> Any | None:
    """Return the functions for an object that is being made, or None for numpy."""
    return path.functions


def compiled_module(name: str) -> ModuleType | None:
    """Load the compiled form of a plain module, which Cython made with the types of its ``.pxd`` file.

    Returns
    -------
    ModuleType or None
        None where the installation had no compiler, or was built from other sources.
    """
    if os.environ.get(SETTING, "1") == "0":
        return None
    source = Path(__file__).parents[1].joinpath(*name.split(".")).with_suffix(".py")
    library = module_library(source)
    if not library.exists():
        return None
    spec = importlib.util.spec_from_file_location(f"{name.rpartition('.')[0]}.{_stem(library)}", library)
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def module_library(source: Path) -> Path:
    """Return the path of the compiled form of a plain module; its name has the hash of both sources."""
    digest = source_hash((source, source.with_suffix(".pxd")))[:16]
    return source.with_name(f"_{source.stem}_{digest}{sysconfig.get_config_var('EXT_SUFFIX')}")


def _stem(library: Path) -> str:
    return library.name.split(".")[0]


def address(array: NDArray[Any]) -> int:
    """Return the address of the first element of a dense array, which the caller keeps alive."""
    try:
        return ctypes.addressof(_octet_of(array))  # a fifth of the time of `array.ctypes.data`
    except (TypeError, ValueError):  # an array that is read-only, or empty
        return int(array.ctypes.data)


def bind(function: Callable[..., Any], *fixed: float | NDArray[Any]) -> Callable[..., Any]:
    """Return a function without its first arguments; arrays among them are passed by address.

    The arrays must stay alive and where they are as long as the function is in use.
    """
    return partial(function, *(address(one) if isinstance(one, np.ndarray) else one for one in fixed))


def dense(array: NDArray[Any], dtype: type[np.generic]) -> NDArray[Any]:
    """Return the array itself where it is dense and of a type, else a copy."""
    return np.ascontiguousarray(array, dtype=dtype)
