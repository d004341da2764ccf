"""Hooks of the build: metadata that depend on where the repository is, and the compiled path of a scan.

``python hatch_build.py`` builds the library of the checkout anew, after a change of `tactiled/compiled*.c`.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

PAPER = "https://doi.org/10.3390/mi10090579"
_LINK = re.compile(r"(?P<picture>!?)\[(?P<words>[^\]]*)\]\((?P<path>(?!https?://|#)[^)]+)\)")


class RepositoryMetadata(MetadataHookInterface):
    """Set `readme` with links that work outside the repository, and `urls`.

    A package index shows README.md alone, so its relative links lead nowhere there. They become absolute once
    `address` in pyproject.toml names the repository; the file itself keeps relative links, which work in a
    checkout and wherever the repository is hosted.
    """

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill the dynamic fields."""
        address, tag = self.config["address"].rstrip("/"), f"v{metadata['version']}"
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["urls"] = {"Paper": PAPER}
        if address:
            metadata["urls"] |= {"Source": address, "Issues": f"{address}/issues"}
            text = with_absolute_links(text, address, tag)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def with_absolute_links(text: str, address: str, tag: str) -> str:
    """Text whose links into the repository are absolute: pictures as raw files, pages as pages."""

    def absolute(link: re.Match[str]) -> str:
        kind = "raw" if link["picture"] else "blob"
        return f"{link['picture']}[{link['words']}]({address}/{kind}/{tag}/{link['path']})"

    return _LINK.sub(absolute, text)


NAMES = "compiled.h", "compiled.c", "compiled_readings.c"
SOURCES, LIBRARY = tuple(f"tactiled/{name}" for name in NAMES), "tactiled/_compiled.so"
# No fused multiply-add, which rounds otherwise than numpy; no errno, so that sqrt is one instruction; nobody
# reads the flags of floating-point exceptions, so that a choice between two values needs no branch.
# No array of variable length: on the stack of a thread, large arrays of sensors would crash the process.
FLAGS = (
    *("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    *("-fvisibility=hidden", "-shared", "-fPIC", "-Wvla", "-Werror=vla"),
)


def compile_library(root: Path) -> bool:
    """Build the library beside its sources; return False where there is no C compiler, or it fails."""
    sources, library = [root / source for source in SOURCES], root / LIBRARY
    new = library.with_suffix(f".{os.getpid()}")
    compiler = shutil.which(os.environ.get("CC", "cc"))
    library.unlink(missing_ok=True)
    if compiler is None:
        print("no C compiler (cc): tactiled runs on numpy, with the same results", file=sys.stderr)
        return False
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    names = [str(source) for source in sources if source.suffix == ".c"]
    command = [compiler, *FLAGS, f'-DTACTILED_SOURCE="{digest}"', *names, "-lm", "-o", str(new)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"tactiled/compiled*.c do not compile, tactiled runs on numpy:\n{done.stderr}", file=sys.stderr)
        new.unlink(missing_ok=True)
        return False
    new.replace(library)  # at once: a process that has the old one loaded keeps it
    return True


MODULES = tuple(f"tactiled/detect/contact/{name}.py" for name in ("memory", "posterior", "signs", "trees"))
# Bits as in Python: no fused multiply-add. Indices are never negative, and arrays never too short.
_DIRECTIVES = (
    *("language_level=3", "annotation_typing=False", "infer_types=True", "boundscheck=False"),
    *("wraparound=False", "initializedcheck=False", "cdivision=True"),
)
_MODULE_FLAGS = "-O2", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC", "-w"


def module_library(source: Path) -> Path:
    """Return the path of the compiled form of a plain module, as `tactiled.compiled` looks for it."""
    digest = hashlib.sha256(source.read_bytes() + source.with_suffix(".pxd").read_bytes()).hexdigest()[:16]
    return source.with_name(f"_{source.stem}_{digest}{sysconfig.get_config_var('EXT_SUFFIX')}")


def compile_modules(root: Path) -> list[Path]:
    """Build the plain modules that have types of C; return none where there is no compiler or no Python.h."""
    compiler, include = shutil.which(os.environ.get("CC", "cc")), Path(sysconfig.get_path("include"))
    if compiler is None or not (include / "Python.h").exists():
        print(
            "no C compiler or no Python.h (python3-dev): the contact filter runs as plain Python",
            file=sys.stderr,
        )
        return []
    found = []
    for source in (root / name for name in MODULES):
        library = module_library(source)
        for old in set(source.parent.glob(f"_{source.stem}_*")) - {library}:
            old.unlink()
        if not library.exists():
            try:
                _compile_module(source, library, compiler, include)
            except subprocess.CalledProcessError as error:
                print(f"{source.name} does not compile, it runs as plain Python: {error}", file=sys.stderr)
                return []
        found.append(library)
    return found


def _compile_module(source: Path, library: Path, compiler: str, include: Path) -> None:
    name = library.name.split(".")[0]
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        shutil.copy(source, work / f"{name}.py")
        shutil.copy(source.with_suffix(".pxd"), work / f"{name}.pxd")
        to_c = [sys.executable, "-m", "cython", *(f"-X{one}" for one in _DIRECTIVES), f"{name}.py"]
        new = library.with_suffix(f".{os.getpid()}")
        to_library = [compiler, *_MODULE_FLAGS, f"-I{include}", f"{name}.c", "-lm", "-o", str(new)]
        for command in (to_c, to_library):
            subprocess.run(command, cwd=work, check=True)
        new.replace(library)  # at once: another process may build the same


class CompiledLibrary(BuildHookInterface):  # type: ignore[type-arg]  # of a configuration that it does not use
    """Build the compiled path of a scan into a wheel, and into the checkout of an editable install."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002  # hatchling's
        """Compile, and mark the wheel as one for this platform."""
        if self.target_name != "wheel" or not compile_library(Path(self.root)):
            return
        root, platform = Path(self.root), re.sub("[-.]", "_", sysconfig.get_platform())
        modules = compile_modules(root)
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-{platform}" if modules else f"py3-none-{platform}"
        build_data["artifacts"] += [LIBRARY, *(str(one.relative_to(root)) for one in modules)]


if __name__ == "__main__":
    _ROOT = Path(__file__).parent
    sys.exit(not (compile_library(_ROOT) and compile_modules(_ROOT)))
