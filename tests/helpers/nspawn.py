"""A Debian with a systemd of its own, in a systemd-nspawn container that lasts as long as the tests.

The package is installed as docs/service.md says, from wheels without the network. Everything has a limit,
and the container ends with this process whatever becomes of it.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hatchling.builders.wheel import WheelBuilder

from tactiled.version import __version__

CHECKOUT = Path(__file__).parents[2]
SUITE, PYTHON = "bookworm", "3.11"  # Debian 12, the oldest that we serve, and the Python that it has
PACKAGES = "systemd,systemd-sysv,dbus,python3,python3-venv,procps"
PROGRAMS = ("systemd-nspawn", "mmdebstrap", "nsenter", "setpriv")
UNITS = Path("etc/systemd/system")
OLD, NEW = "0.0.1", "0.0.2"  # versions that the wheels of the tests say they are
DOWNLOAD_S, COMMAND_S, BOOT_S, OFF_S = 500.0, 200.0, 120.0, 60.0


class ContainerError(Exception):
    """No such container on this machine; the message says why."""


def check_able() -> None:
    """Raise `ContainerError` where it is plain from the start."""
    if os.geteuid() != 0:
        raise ContainerError("containers need root: sudo ./run test tests/system")
    if missing := [program for program in PROGRAMS if shutil.which(program) is None]:
        raise ContainerError(f"{', '.join(missing)} missing: apt install systemd-container mmdebstrap")


def make_root(root: Path) -> None:
    """A small Debian at `root`."""
    command = ["mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", SUITE, str(root)]
    _or_cannot(f"no Debian {SUITE} could be made", command)


def make_all(root: Path, wheels: Path) -> None:
    """A Debian at `root`; in `wheels` both versions, as wheels with all that they need and as packages."""
    check_able()
    with ThreadPoolExecutor() as pool:
        debian = pool.submit(make_root, root)
        download_pins(wheels)
        for version in (OLD, NEW):
            make_wheels(wheels, version)
        make_package(wheels)
        make_upgrade(wheels)
        debian.result()


def make_wheels(folder: Path, version: str) -> None:
    """The checkout as wheels that say they are `version`."""
    copy = folder / f"source-{version}"
    for name in ("tactiled", "protocols", "config", "systemd", "packages"):
        shutil.copytree(CHECKOUT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("README.md", "LICENSE", "hatch_build.py", "pyproject.toml"):
        shutil.copy(CHECKOUT / name, copy)
    projects = [copy / "pyproject.toml", *copy.glob("packages/*/pyproject.toml")]
    for path in (*projects, copy / "packages" / "client" / "tactiled" / "version.py"):
        path.write_text(path.read_text().replace(__version__, version))
    for path in projects:
        list(WheelBuilder(str(path.parent)).build(directory=str(folder)))


def download_pins(folder: Path) -> None:
    """All that the wheels of the checkout need."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    pins = ["--require-hashes", "--requirement", str(CHECKOUT / "requirements" / "daemon.txt")]
    target = ["--python-version", PYTHON, "--only-binary=:all:", "--dest", str(folder)]
    _or_cannot("the wheels could not be had", [*pip, "download", "--no-deps", *pins, *target])


class Container:
    """Boots `root`, with `wheels` at /wheels; a context manager.

    Raises
    ------
    ContainerError
        No systemd comes up in it.
    """

    def __init__(self, root: Path, wheels: Path) -> None:
        self.root = root
        self._wheels = wheels
        self._log = root.with_suffix(".log")

    def __enter__(self) -> "Container":
        # With us it dies (--pdeathsig), and it has its own loopback: no port of the host is in its way.
        command = [
            "setpriv", "--pdeathsig", "TERM",
            "systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--private-network", "--boot",
            "--console=pipe", "--kill-signal=SIGRTMIN+3", f"--bind-ro={self._wheels}:/wheels",
            "--directory", str(self.root),
        ]  # fmt: skip
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        try:
            self._wait_for_boot()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        # Power off, not shut down: nothing in it is kept, and a shutdown may wait for anything.
        for pid in self._children():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        try:
            self._process.wait(OFF_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(OFF_S)

    def _children(self) -> list[int]:
        pid = self._process.pid
        with contextlib.suppress(OSError):
            return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        return []

    def _wait_for_boot(self) -> None:
        until_s = time.monotonic() + BOOT_S
        while time.monotonic() < until_s and self._process.poll() is None:
            for leader in self._children():
                self.leader = leader
                with contextlib.suppress(subprocess.SubprocessError):
                    state = self._enter("systemctl", "is-system-running", limit_s=BOOT_S).stdout.strip()
                    if state in ("running", "degraded"):
                        return
            time.sleep(0.1)
        last = self._log.read_text(errors="replace").strip().splitlines()[-1:]
        raise ContainerError(
            f"no systemd came up in systemd-nspawn within {BOOT_S:.0f} s: {last or 'no word'}"
        )

    def _enter(self, *command: str, limit_s: float) -> "subprocess.CompletedProcess[str]":
        enter = ["nsenter", "--target", str(self.leader), "--all", "--", *command]
        return subprocess.run(enter, capture_output=True, text=True, timeout=limit_s, check=False)

    def run(self, *command: str) -> str:
        """Run a command in it, which must end well; gives what it printed."""
        done = self._enter(*command, limit_s=COMMAND_S)
        assert done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"
        return done.stdout

    def seen(self, path: str) -> str:
        """A path of the running container, as this process can open it."""
        return f"/proc/{self.leader}/root{path}"

    def shown(self, unit: str, *names: str) -> list[str]:
        """Properties of a unit."""
        lines = self.run("systemctl", "show", unit, *(f"--property={name}" for name in names)).splitlines()
        found = dict(line.split("=", 1) for line in lines)
        return [found[name] for name in names]

    def journal(self, unit: str) -> str:
        return self.run("journalctl", "--no-pager", "--output=cat", "--unit", unit)


def wait_until(reached: Callable[[], bool], what: str, limit_s: float = COMMAND_S) -> float:
    """Look until it is so; gives how long that took, in seconds."""
    began_s = time.monotonic()
    while not reached():
        assert time.monotonic() < began_s + limit_s, f"not within {limit_s:.0f} s: {what}"
        time.sleep(0.02)
    return time.monotonic() - began_s


def make_package(wheels: Path) -> None:
    """The Debian package of the old version, in a folder beside its wheels."""
    build = [str(CHECKOUT / "packages/debian/build"), "--version", OLD, "--wheels", ".", "--out", "packages"]
    subprocess.run(build, cwd=wheels, check=True, timeout=DOWNLOAD_S)


def make_upgrade(wheels: Path) -> None:
    """The old package as one of the new version; to install and compile all of it again takes a minute."""
    (old,) = (wheels / "packages").glob(f"tactiled_{OLD}+py3.11_*.deb")
    tree, new = wheels / "upgrade", old.with_name(old.name.replace(OLD, NEW))
    subprocess.run(["dpkg-deb", "--raw-extract", old, tree], check=True, timeout=DOWNLOAD_S)
    for path in (tree / "DEBIAN/control", *tree.glob("opt/tactiled/lib/*/site-packages/tactiled/version.py")):
        path.write_text(path.read_text().replace(OLD, NEW))
    build = ["dpkg-deb", "--root-owner-group", "-Znone", "--build", str(tree), str(new)]
    subprocess.run(build, check=True, timeout=DOWNLOAD_S)
    shutil.rmtree(tree)


def _or_cannot(what: str, command: list[str]) -> None:
    """Run something that needs the network and rights, which a machine may not have."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=DOWNLOAD_S, check=False)
    except subprocess.TimeoutExpired:
        raise ContainerError(f"{what} within {DOWNLOAD_S:.0f} s") from None
    if done.returncode != 0:
        raise ContainerError(f"{what}: {(done.stderr.strip().splitlines() or ['no word'])[-1]}")
