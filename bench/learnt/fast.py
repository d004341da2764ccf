"""The classes that every look runs through, compiled where the machine has a compiler.

`signs`, `memory` and `trees` are plain Python. Cython compiles the same files with the types of the ``.pxd``
files beside them; results have the same bits, and a look takes a fortieth of the time. Without a compiler or
Python.h the plain modules serve.
"""

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from bench.learnt.memory import Memory
from bench.learnt.signs import Signs
from bench.learnt.trees import Trees

__all__ = ["Memory", "Signs", "Trees", "compiled_module"]

_FOLDER = Path(__file__).parent
_MODULES = "memory", "signs", "trees"
# Bits as in Python: no fused multiply-add. Indices are never negative, and arrays never too short.
_DIRECTIVES = (
    *("language_level=3", "annotation_typing=False", "infer_types=True", "boundscheck=False"),
    *("wraparound=False", "initializedcheck=False", "cdivision=True"),
)
_FLAGS = "-O2", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC", "-w"


def compiled_module(name: str) -> ModuleType | None:
    """Return the compiled form of a module of this folder, built first where its sources changed.

    Returns
    -------
    ModuleType or None
        None without a compiler, Cython or Python.h.
    """
    source, types = _FOLDER / f"{name}.py", _FOLDER / f"{name}.pxd"
    digest = hashlib.sha256(source.read_bytes() + types.read_bytes()).hexdigest()[:16]
    library = _FOLDER / f"_{name}_{digest}{sysconfig.get_config_var('EXT_SUFFIX')}"
    if not library.exists() and not _build(source, types, library):
        return None
    spec = importlib.util.spec_from_file_location(f"bench.learnt.{library.name.split('.')[0]}", library)
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _build(source: Path, types: Path, library: Path) -> bool:
    compiler, include = shutil.which("cc"), Path(sysconfig.get_path("include"))
    if compiler is None or importlib.util.find_spec("Cython") is None or not (include / "Python.h").exists():
        return False
    for old in set(library.parent.glob(f"_{source.stem}_*")) - {library}:
        old.unlink()
    name = library.name.split(".")[0]
    with tempfile.TemporaryDirectory(dir=library.parent) as temporary:
        work = Path(temporary)
        shutil.copy(source, work / f"{name}.py")
        shutil.copy(types, work / f"{name}.pxd")
        to_c = [sys.executable, "-m", "cython", *(f"-X{one}" for one in _DIRECTIVES), f"{name}.py"]
        to_library = [compiler, *_FLAGS, f"-I{include}", f"{name}.c", "-lm", "-o", library.name]
        for command in (to_c, to_library):
            subprocess.run(command, cwd=work, check=True)
        (work / library.name).replace(library)  # at once: another process may build the same
    return True


if not TYPE_CHECKING:
    _found = [compiled_module(name) for name in _MODULES]
    if all(_found):
        Memory, Signs, Trees = _found[0].Memory, _found[1].Signs, _found[2].Trees
