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


NAMES = "compiled.h", "compiled.c", "compiled_readings.c", "compiled_contact.c", "compiled_grip.c"
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


class CompiledLibrary(BuildHookInterface):  # type: ignore[type-arg]  # of a configuration that it does not use
    """Build the compiled path of a scan into a wheel, and into the checkout of an editable install."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002  # hatchling's
        """Compile, and mark the wheel as one for this platform."""
        if self.target_name != "wheel" or not compile_library(Path(self.root)):
            return
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{re.sub('[-.]', '_', sysconfig.get_platform())}"
        build_data["artifacts"].append(LIBRARY)


if __name__ == "__main__":
    sys.exit(not compile_library(Path(__file__).parent))
