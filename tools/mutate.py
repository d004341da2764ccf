"""Measure how many small faults in a room its tests find: ``./run mutate ROOM [--count 40] [--seed 0]``.

The tree is copied to a temporary folder. In the copy one place of the room is changed at a time, at random
(see `tools.mutations`), and the tests of the room run until the first of them fails, those named after the
changed module first. A change that no test finds is printed as a survivor. A change that makes no difference
counts as one, too: the score is a lower bound.

mutmut 3 wraps functions, so it changes no constant of a module; cosmic-ray changes the files of the checkout.
Neither draws a sample, and each brings seven libraries or more.
"""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Self

from tools.mutations import Mutation, mutations

ROOT = Path(__file__).resolve().parents[1]
# No files of git, but the tests run on them.
_COMPILED = "tactiled/**/_*.so"
# Folders that hold a part of the package `tactiled`.
_PARTS = ("tactiled", "packages/*/tactiled")
# The client over zenoh needs a router and a bridge, which the tests of the room zenoh have.
_ALSO = {"client": ("zenoh",)}
# A mutation may make a loop endless. A machine that others use may be slower than without a mutation.
_TIMES_BASELINE, _LEAST_TIMEOUT_S = 3.0, 15.0
_OPTIONS = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--basetemp", "t")


class Tree:
    """A copy of the tree in a temporary folder, in which one file is changed at a time.

    The tracked and new files of the checkout are copied, nothing in it is changed. A room is a folder or a
    module of the package `tactiled`, of any distribution.
    """

    def __init__(self, root: Path, room: str) -> None:
        self.copy = Path(tempfile.mkdtemp(prefix="mutate-"))
        command = ["git", "-C", str(root), "ls-files", "-co", "--exclude-standard", "-z"]
        names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\0")
        compiled = [str(path.relative_to(root)) for path in root.glob(_COMPILED)]
        for name in [*names, *compiled]:
            if name and (root / name).is_file():
                (self.copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, self.copy / name)
        self.parts = [found.parent for pattern in _PARTS for found in sorted(self.copy.glob(pattern))]
        places = [part / "tactiled" / room for part in self.parts]
        there = [place for place in places if place.is_dir() or place.with_suffix(".py").is_file()]
        folder, package = self.copy / "tests" / room, (there or places)[0]
        examples = package if package.is_dir() else package.with_suffix(".py")
        self.sources = sorted(package.rglob("*.py")) or [path for path in [examples] if path.is_file()]
        tests = sorted(folder.rglob("test_*.py")) or sorted((self.copy / "tests").glob(f"test_{room}*.py"))
        tests += [self.copy / "tests" / other for other in _ALSO.get(room, ())]
        self.tests = [path.relative_to(self.copy) for path in [*tests, examples]]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self.copy, ignore_errors=True)

    def mutations(self) -> list[list[Mutation]]:
        """Every place of the room that can be changed, with its mutations."""
        return [
            one
            for path in self.sources
            for one in mutations(path.read_text(), str(path.relative_to(self.copy)))
        ]

    @contextmanager
    def mutated(self, mutation: Mutation) -> Iterator[None]:
        """Change the copy for as long as the context lasts."""
        path = self.copy / mutation.file
        before = path.read_bytes()
        path.write_text(mutation.apply(before.decode()))
        try:
            self._compile(path)
            yield
        finally:
            path.write_bytes(before)
            self._compile(path)

    def _compile(self, path: Path) -> None:
        """Compile a module that has types of C; as plain Python it would make the tests ten times as long."""
        if path.with_suffix(".pxd").is_file():
            command = [sys.executable, "hatch_build.py"]
            subprocess.run(command, cwd=self.copy, capture_output=True, check=False)

    def failure(self, changed: str = "", timeout_s: float | None = None) -> str:
        """Run the tests, with those named after a changed file first; what they print where one fails."""
        order = sorted(self.tests, key=lambda test: not (changed and test.stem.endswith(Path(changed).stem)))
        paths = os.pathsep.join([*map(str, self.parts), str(self.copy / "tests" / "helpers")])
        # No bytecode: a file that is changed twice in a second would be taken for the older one.
        environment = os.environ | {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
        with subprocess.Popen(
            [sys.executable, "-m", "pytest", *_OPTIONS, *map(str, order)],
            cwd=self.copy, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            start_new_session=True,
        ) as tests:  # fmt: skip
            try:
                said, _ = tests.communicate(timeout=timeout_s)
            except subprocess.TimeoutExpired:
                return "timeout"
            finally:
                with suppress(ProcessLookupError):  # and all that they have started
                    os.killpg(tests.pid, signal.SIGKILL)
        return said if tests.returncode else ""


def measure(root: Path, room: str, count: int, seed: int) -> float:
    """Print the survivors among random mutations of a room, and return the share that the tests find."""
    with Tree(root, room) as tree:
        if not tree.sources:
            raise SystemExit(f"mutate: there is no tactiled/{room}")
        everything = tree.mutations()
        draw = random.Random(seed)
        drawn = [draw.choice(place) for place in draw.sample(everything, min(count, len(everything)))]
        words = f"mutate: {room}: {len(everything)} places, {len(drawn)} drawn with seed {seed}"
        print(words, file=sys.stderr)
        began_s = time.monotonic()
        if failure := tree.failure():
            raise SystemExit(f"mutate: the tests fail without a mutation\n{failure[-3000:]}")
        baseline_s = time.monotonic() - began_s
        print(f"mutate: the tests take {baseline_s:.0f} s without a mutation", file=sys.stderr)
        timeout_s = max(_LEAST_TIMEOUT_S, _TIMES_BASELINE * baseline_s)
        killed = 0
        for mutation in drawn:
            with tree.mutated(mutation):
                survived = not tree.failure(mutation.file, timeout_s)
            killed += not survived
            words = f"{'survived' if survived else 'killed  '} {mutation}"
            print(words, file=sys.stdout if survived else sys.stderr, flush=True)
        print(f"{room}: {killed} of {len(drawn)} mutations killed, {killed / len(drawn):.0%} (seed {seed})")
        return killed / len(drawn)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; 1 where a room is below the aim."""
    parser = argparse.ArgumentParser(prog="./run mutate", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("room", help="folder or module of tactiled, for example wire")
    parser.add_argument("--count", type=int, default=40, help="mutations to try (default: 40)")
    parser.add_argument("--seed", type=int, default=0, help="which mutations are drawn (default: 0)")
    parser.add_argument(
        "--aim", type=float, default=0.85, help="least share killed for exit code 0 (default: 0.85)"
    )
    given = parser.parse_args(arguments)
    return int(measure(ROOT, given.room, given.count, given.seed) < given.aim)


if __name__ == "__main__":
    sys.exit(main())
