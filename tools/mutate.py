"""Measure how many small faults in a room its tests find: ``./run mutate ROOM [--count 40] [--seed 0]``.

The tree is copied to a temporary folder. In the copy one place of the room is changed at a time, at random
(see `tools.mutations`), and the tests of the room run until the first of them fails. A change that no test
finds is printed as a survivor. A change that makes no difference counts as one, too: the score is a lower
bound.

1. The tests run once without a change. Coverage notes which test executes which line.
2. For each change, a forked process that has numpy and the other libraries in memory runs the test files that
   execute the line, the one named after the module first. Tests that start processes may execute any line.

mutmut 3 wraps functions, so it changes no constant of a module; cosmic-ray changes the files of the checkout.
Neither draws a sample, and each brings seven libraries or more.
"""

import argparse
import importlib
import os
import pickle
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import coverage
import pytest
from hypothesis import Phase, settings

from tools.mutations import Mutation, mutations

ROOT = Path(__file__).resolve().parents[1]
# No files of git, but the tests run on them.
_COMPILED = "tactiled/**/_*.so"
# Folders that hold a part of the package `tactiled`.
_PARTS = ("tactiled", "packages/*/tactiled")
# The client over zenoh needs a router and a bridge, which the tests of the room zenoh have.
_ALSO = {"client": ("zenoh",)}
# A mutation may make a loop endless. A machine that others use may be slower than at the baseline.
_TIMES_BASELINE, _LEAST_TIMEOUT_S = 5.0, 15.0
_START_S = 60.0  # for the imports and the collection of tests, which may hang as well
_STARTS_PROCESS = {"subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.system"}
# A failure is a failure: hypothesis need not look for the shortest example.
_PROFILE = "mutate"
settings.register_profile(
    _PROFILE, deadline=None, derandomize=True, database=None, phases=(Phase.explicit, Phase.generate)
)


@dataclass
class Baseline:
    """What the tests do without a mutation. Tests have their pytest node ids."""

    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    starts_process: set[str] = field(default_factory=set)
    executed: dict[str, dict[int, list[str]]] = field(
        default_factory=dict
    )  # file, line: tests; "" is the import
    modules: list[str] = field(default_factory=list)  # libraries that the tests have imported
    compiled: set[str] = field(default_factory=set)  # files of Python that were compiled

    def tests_of(self, mutation: Mutation) -> dict[str, float]:
        """Tests that can find a mutation, in the order in which they should run, with their seconds."""
        lines = self.executed.get(mutation.file, {})
        here = {test for line in mutation.lines for test in lines.get(line, ())}
        direct = (here - {""}) | self.starts_process
        # A name of the module or a default value is used by lines that import it: every test may see it. What
        # is compiled hides its lines from coverage.
        anywhere = "" in here or mutation.file in self.compiled
        files = {_file(test) for test in (self.seconds if anywhere else direct)}
        users = {_file(test) for tests in lines.values() for test in tests if test}
        stem = Path(mutation.file).stem
        cost: dict[str, float] = defaultdict(float)
        for test, seconds in self.seconds.items():
            cost[_file(test)] += seconds
        # A fixture of a file may have executed the line for another of its tests, so all tests of a file run.
        order = sorted(
            (test for test in self.seconds if _file(test) in files),
            key=lambda test: (
                not Path(_file(test)).stem.endswith(stem),
                _file(test) not in users,
                cost[_file(test)],
                _file(test),
                test not in direct,
                self.seconds[test],
            ),
        )
        return {test: self.seconds[test] for test in order}


def _file(test: str) -> str:
    return test.partition("::")[0]


class _Observer:
    """Plugin of pytest that fills a `Baseline`."""

    def __init__(self, baseline: Baseline, measure: coverage.Coverage) -> None:
        self.baseline, self.measure, self.test = baseline, measure, ""
        sys.addaudithook(self._audit)

    def _audit(self, event: str, _arguments: object) -> None:
        if event in _STARTS_PROCESS and self.test:
            self.baseline.starts_process.add(self.test)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.test = nodeid
        self.measure.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.baseline.seconds[report.nodeid] += report.duration


class _Order:
    """Plugin of pytest that runs the tests that are named, in their order, each with a timeout."""

    def __init__(self, timeouts_s: dict[str, float]) -> None:
        self.place = {test: place for place, test in enumerate(timeouts_s)}
        self.timeouts_s = timeouts_s

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        chosen = [item for item in items if item.nodeid in self.place]
        items[:] = sorted(chosen, key=lambda item: self.place[item.nodeid])
        for item in items:
            item.add_marker(pytest.mark.timeout(self.timeouts_s[item.nodeid]), append=False)


class Tree:
    """A copy of the tree in a temporary folder, in which one file is changed at a time.

    Parameters
    ----------
    root
        The checkout; its tracked and new files are copied, nothing in it is changed.
    room
        Folder or module of the package `tactiled`, of any distribution.
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
        tests = [folder] if folder.is_dir() else sorted((self.copy / "tests").glob(f"test_{room}*.py"))
        tests += [self.copy / "tests" / other for other in _ALSO.get(room, ())]
        self.sources = sorted(package.rglob("*.py")) or [
            path for path in [package.with_suffix(".py")] if path.is_file()
        ]
        examples = package if package.is_dir() else package.with_suffix(".py")
        self.tests = [str(path.relative_to(self.copy)) for path in [*tests, examples]]

    def __enter__(self) -> "Tree":
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
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
        before, stat = path.read_bytes(), path.stat()
        path.write_text(mutation.apply(before.decode()))
        os.utime(path, (stat.st_atime, stat.st_mtime + 10.0))  # so that no older bytecode is taken for it
        try:
            self._compile(path)
            yield
        finally:
            path.write_bytes(before)
            os.utime(path, (stat.st_atime, stat.st_mtime))
            self._compile(path)

    def _compile(self, path: Path) -> None:
        """Compile a module that has types of C; as plain Python it would make the tests ten times as long."""
        if path.with_suffix(".pxd").is_file():
            command = [sys.executable, "hatch_build.py"]
            subprocess.run(command, cwd=self.copy, capture_output=True, check=False)

    def baseline(self) -> Baseline:
        """Run all tests without a mutation; raise SystemExit where one fails."""
        kept = self.copy / "baseline.pickle"

        def observe() -> int:
            sources = [str(part / "tactiled") for part in self.parts]
            measure = coverage.Coverage(data_file=None, source=sources, config_file=False)
            baseline = Baseline()
            measure.start()
            # Coverage and other work on the machine slow tests down, so no time is too long here.
            code = _pytest(["--timeout", "0", *self.tests], _Observer(baseline, measure))
            measure.stop()
            data = measure.get_data()
            for path in data.measured_files():
                name = str(Path(path).relative_to(self.copy))
                baseline.executed[name] = dict(data.contexts_by_lineno(path))
            baseline.seconds = dict(baseline.seconds)
            typed = (path.with_suffix(".py") for path in self.copy.glob("tactiled/**/*.pxd"))
            baseline.compiled = {str(path.relative_to(self.copy)) for path in typed}
            baseline.modules = [name for name, module in sys.modules.items() if _is_library(module)]
            kept.write_bytes(pickle.dumps(baseline))
            return code

        log = self.copy / "baseline.txt"
        if self._in_child(observe, log, timeout_s=None):
            raise SystemExit(f"mutate: the tests fail without a mutation\n{log.read_text()[-3000:]}")
        found: Baseline = pickle.loads(kept.read_bytes())
        return found

    def survives(self, tests: dict[str, float]) -> bool:
        """Say whether tests pass in the tree as it is now.

        Parameters
        ----------
        tests
            Tests in the order in which they run, with the seconds that each took without a mutation. A test
            that takes several times as long has failed.
        """
        if not tests:
            return True
        os.environ["PYTHONDONTWRITEBYTECODE"] = "1"
        timeouts_s = {test: max(_LEAST_TIMEOUT_S, _TIMES_BASELINE * s) for test, s in tests.items()}
        files = list(dict.fromkeys(_file(test) for test in tests))
        log, limit_s = self.copy / "tests.txt", _START_S + _TIMES_BASELINE * sum(tests.values())
        return self._in_child(lambda: _pytest(files, _Order(timeouts_s)), log, limit_s) == 0

    def _in_child(self, run: Callable[[], int], log: Path, timeout_s: float | None) -> int:
        """Exit code of `run` in a forked process, killed with all that it started after the timeout."""
        child = os.fork()
        if not child:
            code = 70
            try:
                os.setsid()
                sys.stdout = sys.stderr = log.open("w")
                for descriptor in (1, 2):
                    os.dup2(sys.stdout.fileno(), descriptor)
                os.chdir(self.copy)
                paths = [str(part) for part in self.parts]
                os.environ["PYTHONPATH"] = os.pathsep.join(paths)
                sys.path[:0] = paths
                for name in [name for name in sys.modules if name.partition(".")[0] == "tactiled"]:
                    del sys.modules[name]  # of the checkout
                sys.dont_write_bytecode = "PYTHONDONTWRITEBYTECODE" in os.environ
                code = run()
            finally:
                sys.stdout.flush()
                os._exit(code)
        end_s = time.monotonic() + (timeout_s or float("inf"))
        try:
            while not (done := os.waitpid(child, os.WNOHANG))[0]:
                if time.monotonic() > end_s:
                    return -1
                time.sleep(0.02)
            return os.waitstatus_to_exitcode(done[1])
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)


def _is_library(module: object) -> bool:
    """Say whether a module comes from an installed library: these do not depend on the tree."""
    path = getattr(module, "__file__", None) or ""
    return "site-packages" in path and not any(word in path for word in ("pytest", "hypothesis", "coverage"))


def _pytest(tests: list[str], plugin: object) -> int:
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-profile", _PROFILE]
    options += ["--basetemp", "t", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    return int(pytest.main([*options, *tests], plugins=[plugin]))


def measure(root: Path, room: str, count: int, seed: int) -> float:
    """Print the survivors among random mutations of a room.

    Returns
    -------
    Share of the mutations that the tests find.
    """
    with Tree(root, room) as tree:
        if not tree.sources:
            raise SystemExit(f"mutate: there is no tactiled/{room}")
        everything = tree.mutations()
        draw = random.Random(seed)
        drawn = [draw.choice(place) for place in draw.sample(everything, min(count, len(everything)))]
        print(
            f"mutate: {room}: {len(everything)} places, {len(drawn)} drawn with seed {seed}", file=sys.stderr
        )
        began_s = time.monotonic()
        baseline = tree.baseline()
        baseline_s = time.monotonic() - began_s
        print(
            f"mutate: {len(baseline.seconds)} tests in {baseline_s:.0f} s without a mutation", file=sys.stderr
        )
        for name in baseline.modules:
            with suppress(Exception):  # some modules of a library are only for another platform
                importlib.import_module(name)
        killed = 0
        for mutation in drawn:
            began_s = time.monotonic()
            with tree.mutated(mutation):
                survived = tree.survives(baseline.tests_of(mutation))
            killed += not survived
            words = f"{'survived' if survived else 'killed  '} {mutation}"
            print(
                words,
                f"({time.monotonic() - began_s:.1f} s)",
                file=sys.stdout if survived else sys.stderr,
                flush=True,
            )
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
