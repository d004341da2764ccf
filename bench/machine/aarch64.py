"""The Debian package for aarch64: its events, number by number, beside those of this host.

qemu-user runs the program in a folder with the files of an aarch64 Debian 12.
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import aims_table, never, table
from bench.scenes import record_scene
from tactiled.emulator.scene.description import load_scene
from tactiled.errors import OperatorError

# Programs that this needs, and the Debian packages that have them
PACKAGES = {
    "qemu-aarch64-static": "qemu-user-static",
    "aarch64-linux-gnu-gcc": "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
    "mmdebstrap": "mmdebstrap",
}
# Seconds of scenes: a second of a slide over grooves takes 20 s of an emulated processor.
_SCENES = {"demo": 12.0, "stick-slip": 8.0, str(Path(__file__).parents[1] / "throughput/slide.toml"): 8.0}


def compare(package: Path, folder: Path) -> list[str]:
    """Unpack a package for arm64 in a folder, and compare its events with those of this host."""
    root = folder / "root"
    debian = ["--variant=extract", "--architectures=arm64", "--include=python3,libstdc++6", "bookworm"]
    subprocess.run(["mmdebstrap", "--quiet", *debian, str(root)], check=True)
    subprocess.run(["dpkg-deb", "--extract", str(package), str(root)], check=True)
    emulator = shutil.which("qemu-aarch64-static")
    assert emulator is not None  # `need_programs`
    shutil.copy(emulator, root)
    rows, n_others = [], 0
    for name, duration_s in _SCENES.items():
        recording = root / "tmp" / f"{Path(name).stem}.mcap"
        record_scene(recording, load_scene(name), duration_s)
        here = _events([sys.executable, "-m", "tactiled", "detect", str(recording), "--json"])
        python = "/qemu-aarch64-static", "/opt/tactiled/bin/python", "-m", "tactiled"
        there = _events(["chroot", str(root), *python, "detect", f"/tmp/{recording.name}", "--json"])
        if [one["topic"] for one in here] != [one["topic"] for one in there]:
            raise OperatorError(
                f"scene {recording.stem}: other events on aarch64: {len(here)} here, {len(there)} there"
            )
        differs = [one["topic"] for one, other in zip(here, there, strict=True) if one != other]
        n_others += sum(topic != "texture" for topic in differs)
        n_textures = sum(one["topic"] == "texture" for one in here)
        largest = max(map(_difference, here, there), default=0.0)
        rows.append(
            {
                "recording": f"scene {recording.stem}, {duration_s:g} s",
                "events": f"{len(here)}",
                "texture events that differ": f"{differs.count('texture')} of {n_textures}",
                "largest difference of a number (relative)": f"{largest:.1g}",
            }
        )
    return [aims_table([never("events but texture that differ from those of x86_64", n_others)]), table(rows)]


def _events(command: Sequence[str]) -> list[dict[str, Any]]:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OperatorError(f"{' '.join(command)}: {done.stderr.strip()[-500:]}")
    return [json.loads(line) for line in done.stdout.splitlines()]


def _difference(one: dict[str, Any], other: dict[str, Any]) -> float:
    """Return the largest relative difference of the numbers of two events; infinite where others differ."""
    largest = 0.0
    for key, value in one.items():
        if value == other[key]:
            continue
        if not isinstance(value, float):
            return float("inf")
        largest = max(largest, abs(value - other[key]) / max(abs(value), np.finfo(float).tiny))
    return largest
