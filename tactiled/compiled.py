"""The compiled path of a scan: modules of plain Python that Cython compiled at installation.

A module of `MODULES` has a ``.pxd`` file with types of C beside it. `hatch_build.py` compiles the same source
where it finds a C compiler and Python.h; both forms give the same bits. The name of a library has the hash of
its sources, so that one of other sources is not used. ``TACTILED_COMPILED=0`` in the environment forces plain
Python.
"""

import hashlib
import importlib.util
import os
import sysconfig
from pathlib import Path
from types import ModuleType

MODULES = (
    "tactiled.wire.good_scans",
    "tactiled.samples.bucket",
    "tactiled.samples.envelope",
    "tactiled.samples.unwrap",
    "tactiled.detect.signal.front_end",
    "tactiled.detect.signal.pressure",
    *(f"tactiled.detect.contact.{name}" for name in ("filter", "friction", "hysteresis", "memory")),
    *(f"tactiled.detect.contact.{name}" for name in ("posterior", "signs", "trees")),
)
SETTING = "TACTILED_COMPILED"
_ROOT = Path(__file__).parents[1]


def compiled_module(name: str) -> ModuleType | None:
    """Load the compiled form of a plain module; None without a compiler, or if built from other sources."""
    if os.environ.get(SETTING, "1") == "0":
        return None
    library = module_library(module_source(name))
    if not library.exists():
        return None
    stem = library.name.split(".")[0]
    spec = importlib.util.spec_from_file_location(f"{name.rpartition('.')[0]}.{stem}", library)
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def module_source(name: str, root: Path = _ROOT) -> Path:
    """Return the path of a plain module."""
    return root.joinpath(*name.split(".")).with_suffix(".py")


def module_library(source: Path) -> Path:
    """Return the path of the compiled form of a plain module; its name has the hash of both sources."""
    sources = source.read_bytes() + source.with_suffix(".pxd").read_bytes()
    digest = hashlib.sha256(sources).hexdigest()[:16]
    return source.with_name(f"_{source.stem}_{digest}{sysconfig.get_config_var('EXT_SUFFIX')}")


def why_plain(root: Path = _ROOT) -> str:
    """Return the reason why scans take plain Python; empty where all modules are compiled."""
    if os.environ.get(SETTING, "1") == "0":
        return f"{SETTING}=0"
    sources = [module_source(name, root) for name in MODULES]
    missing = [source for source in sources if not module_library(source).exists()]
    if any(list(source.parent.glob(f"_{source.stem}_*")) for source in missing):
        return "built from other sources: install again"
    if missing:
        return "built without a C compiler or Python.h: install gcc and python3-dev, then tactiled again"
    return ""


reason_plain = why_plain()
"""Reason why scans of this process take plain Python; empty where they do not."""


def path_words() -> str:
    """Return the path that a scan takes, in words."""
    return f"plain Python ({reason_plain})" if reason_plain else "compiled"
