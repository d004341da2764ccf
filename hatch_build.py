"""Hooks of the build: metadata that depend on where the repository is, and the compiled path of a scan.

``python hatch_build.py`` compiles the modules of the checkout anew, after a change of one of their sources.
"""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
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


# Bits as in Python: no fused multiply-add. Indices are never negative, and arrays never too short.
_DIRECTIVES = (
    *("language_level=3", "annotation_typing=False", "infer_types=True", "boundscheck=False"),
    *("wraparound=False", "initializedcheck=False", "cdivision=True"),
    *("auto_pickle=False", "binding=False"),  # nobody needs these, and they are a seventh of the C
)
_MODULE_FLAGS = "-O2", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC", "-w"


def compile_modules(root: Path) -> list[Path]:
    """Build the plain modules that have types of C; return none where there is no compiler or no Python.h."""
    spec = importlib.util.spec_from_file_location("compiled", root / "tactiled" / "compiled.py")
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    names = importlib.util.module_from_spec(spec)  # alone: the package need not be installed yet
    spec.loader.exec_module(names)
    compiler, include = shutil.which(os.environ.get("CC", "cc")), Path(sysconfig.get_path("include"))
    reason = ""
    if compiler is None or not (include / "Python.h").exists():
        reason = "no C compiler or no Python.h (python3-dev)"
    found, due = [], []
    for source in (names.module_source(name, root) for name in names.MODULES):
        library = names.module_library(source)
        for old in set(source.parent.glob(f"_{source.stem}_*.so")) - {library}:
            old.unlink(missing_ok=True)  # another process may do the same
        if library.exists():
            library.touch()  # newer than its sources, by which `run` sees that there is nothing to do
        else:
            due.append((source, library))
        found.append(library)
    if due and not reason:
        assert compiler is not None
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            jobs = [pool.submit(_compile_module, *one, compiler, include) for one in due]
        failed = [job.exception() for job in jobs if job.exception() is not None]
        reason = f"{failed[0]}" if failed else ""
    elif not due:
        reason = ""
    if reason:
        print(f"{reason}: scans take plain Python, with the same results", file=sys.stderr)
        return []
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


class CompiledPath(BuildHookInterface):  # type: ignore[type-arg]  # of a configuration that it does not use
    """Build the compiled path of a scan into a wheel, and into the checkout of an editable install."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002  # hatchling's
        """Compile, and mark the wheel as one for this platform and this Python."""
        root = Path(self.root)
        if self.target_name != "wheel" or not (modules := compile_modules(root)):
            return
        python, platform = f"cp{sys.version_info.major}{sys.version_info.minor}", sysconfig.get_platform()
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-{re.sub('[-.]', '_', platform)}"
        build_data["artifacts"] += [str(one.relative_to(root)) for one in modules]


if __name__ == "__main__":
    sys.exit(not compile_modules(Path(__file__).parent))
