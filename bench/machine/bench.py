"""A whole robot host in a virtual machine: package, setup, boot, USB, clock, disk, memory, power cuts.

Debian 12 runs in qemu, which emulates the processor, with its own kernel, systemd, udev and ext4. The Debian
package of this checkout is installed in it, and `tactiled setup` sets it up; the same is done in Debian 13.
The emulated boards run on this host, behind the FTDI adapters that qemu emulates. Each part starts from a
disk of its own: as Debian makes it, or with the package installed and set up, which is kept in the cache of
this user until the package changes. It is installed by the Debian's own dpkg, run by this host, and in the
part `setup` by the guest, which takes minutes. The parts `aarch64` and `firmware` have no virtual machine.
"""

import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from bench.machine import aarch64, cases, firmware
from bench.machine.guest import PROCESSORS, RATE_HZ, Board, Guest
from bench.machine.image import SUITES, Image, make_image
from bench.machine.qemu import version
from bench.processes import need_programs
from bench.report import Aim, BenchOptions, aims_table, load_words
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

_ROOT = Path(__file__).parents[2]
# What the package and the configuration of the guest are made from
_INPUTS = ("tactiled", "packages", "config", "protocols", "systemd", "requirements", "pyproject.toml",
           "hatch_build.py")  # fmt: skip


@dataclass
class _Bench:
    """Boards and folder of a part, and how often each of its cases is done."""

    folder: Path
    board: Board
    other: Board
    quick: bool

    def times(self, usual: int) -> int:
        """Return how often to do something that is usually done so often."""
        return max(usual // 10, 1) if self.quick else usual


def _part_setup(bench: _Bench) -> list[str]:
    """Package and setup, and what a purge leaves."""
    with Guest(make_image("bookworm"), bench.folder / "setup") as guest:
        shutil.copy(_package("bookworm"), guest.share)
        guest.boot()
        before = cases.tree(guest)
        began_s = cases.monotonic_s(guest)
        cases.install(guest)
        took_s = cases.monotonic_s(guest) - began_s
        aims = cases.set_up_board(guest, bench.board)
        purged, left = cases.purge(guest, before)
        words = f"Left by a purge: {', '.join(left)}" if left else ""
        return [
            _words(guest, f"dpkg took {took_s:.0f} s."),
            aims_table(aims + purged),
            *filter(None, [words]),
        ]


# Cases of the parts that begin with the package installed and a board set up and plugged in
_ON_INSTALLED: dict[str, Callable[[Guest, _Bench], list[Aim]]] = {
    # Users without rights, and the journal that a person reads
    "users": lambda guest, _: cases.without_rights(guest) + cases.journal(guest),
    # Adapters that are pulled out, moved and swapped
    "usb": lambda guest, bench: [
        *cases.replug(guest, bench.board, bench.times(20)),
        *cases.journal(guest),
        *cases.swap(guest, bench.board, bench.other, bench.times(4)),
    ],
    # Clocks that are stepped and slewed
    "clock": lambda guest, bench: cases.step_clock(guest, bench.board) + cases.slew_clock(guest, bench.board),
    # Suspend to memory, and resume
    "suspend": lambda guest, bench: cases.suspend(guest, bench.board),
    # Too little disk, memory and processor
    "shortage": lambda guest, bench: [
        *cases.fill_disk(guest),
        *cases.fill_memory(guest),
        *cases.load_processor(guest, bench.board, bench.other),
    ],
    # Disks as power cuts leave them while the daemon records
    "power": lambda guest, bench: cases.copy_disk(guest, bench.times(20), bench.folder),
    # Power cuts, each with a boot, and the times from power on to the first fresh scan
    "boot": lambda guest, bench: [
        *cases.cut_power(guest, bench.board, bench.times(3)),
        *cases.boot(guest, bench.board, bench.times(3)),
    ],
}


def _on_installed(name: str, bench: _Bench) -> list[str]:
    """Do one of these parts."""
    with Guest(with_package("bookworm", is_set_up=True), bench.folder / name) as guest:
        guest.boot(bench.board)
        aims = _ON_INSTALLED[name](guest, bench)
        return [_words(guest), aims_table(aims)]


def _part_newer(bench: _Bench) -> list[str]:
    """Debian 13."""
    with Guest(with_package("trixie"), bench.folder / "newer") as guest:
        guest.boot()
        aims = cases.set_up_board(guest, bench.board)
        aims += cases.first_scans(guest)
        return [_words(guest), aims_table(aims)]


def _part_aarch64(bench: _Bench) -> list[str]:
    """The package for another processor."""
    need_programs(aarch64.PACKAGES)
    words = "The Debian package for arm64, unpacked in Debian 12, under qemu-user; compiled modules on both."
    return [words, *aarch64.compare(_package("bookworm", "arm64"), bench.folder)]


_PARTS: dict[str, Callable[[_Bench], list[str]]] = {
    "setup": _part_setup,
    **{name: partial(_on_installed, name) for name in _ON_INSTALLED},
    "newer": _part_newer,
    "aarch64": _part_aarch64,
    # The example firmware, ten minutes with resets, half of them within a frame
    "firmware": lambda bench: firmware.soak(bench.folder, bench.times(600), bench.times(20)),
}


def bench_machine(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Do all parts, or those asked for, and print what became of each case."""
    if unknown := set(options.parts) - set(_PARTS):
        raise OperatorError(f"no part {', '.join(sorted(unknown))}; there are {', '.join(_PARTS)}")
    sections = []
    for name in options.parts or _PARTS:
        progress.note(name)
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            board, other = (stack.enter_context(Board(folder, serial)) for serial in ("TS0001", "TS0002"))
            sections += _PARTS[name](_Bench(folder, board, other, options.quick))
    return sections


def _words(guest: Guest, more: str = "") -> str:
    """Return the system that was measured, and its conditions."""
    system = guest.run("echo Debian $(cat /etc/debian_version), Linux $(uname -r)")
    return (
        f"{system} in {version('qemu-system-x86_64')} without KVM, {PROCESSORS} emulated processors, on a "
        f"host with {load_words()}; boards at {RATE_HZ:g} Hz. Seconds are of the guest. {more}"
    ).strip()


def _made_from() -> str:
    """Digest of all that the package is made from."""
    digest = hashlib.sha256()
    listed = subprocess.check_output(["git", "ls-files", "-z", *_INPUTS], cwd=_ROOT)
    for path in listed.decode().split("\0")[:-1]:
        digest.update(path.encode() + (_ROOT / path).read_bytes())
    return digest.hexdigest()[:12]


def _kept(image: Image, stem: str, ending: str) -> Path:
    """Path beside an image for what is made from this package; removes those of others."""
    wanted = image.disk.with_name(f"{stem}-{_made_from()}{ending}")
    for other in set(wanted.parent.glob(f"{stem}-*{ending}")) - {wanted}:
        other.unlink()
    return wanted


def _package(suite: str, arch: str = "amd64") -> Path:
    """Path of the package for a Debian; builds it where there is none of this checkout."""
    package = _kept(make_image(suite), f"tactiled_{arch}", ".deb")
    if not package.exists():
        with tempfile.TemporaryDirectory() as folder:
            command = [str(_ROOT / "packages/debian/build"), "--python", SUITES[suite], "--arch", arch]
            command += ["--out", folder]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            shutil.move(next(Path(folder).glob("*.deb")), package)
    return package


def with_package(suite: str, *, is_set_up: bool = False) -> Image:
    """Disk of a Debian whose own dpkg has installed the package on this host; with a board, where set up."""
    image = make_image(suite)
    disk = _kept(image, "installed" if is_set_up else "package", ".raw")
    if not disk.exists():
        with tempfile.TemporaryDirectory(dir=disk.parent) as folder:
            copy, root = Path(folder, "disk"), Path(folder, "root")
            root.mkdir()
            subprocess.run(["cp", "--sparse=always", str(image.disk), str(copy)], check=True)
            subprocess.run(["mount", "-o", "loop", str(copy), str(root)], check=True)
            try:
                shutil.copy(_package(suite), root / "package.deb")
                command = ["chroot", str(root), "dpkg", "--install", "/package.deb"]
                subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
                (root / "package.deb").unlink()
                if is_set_up:
                    (root / cases.CONFIG.lstrip("/")).write_text(cases.CONFIG_TEXT)
                    wants = root / f"etc/systemd/system/multi-user.target.wants/{cases.UNIT}"
                    wants.parent.mkdir(exist_ok=True)
                    wants.symlink_to("/usr/lib/systemd/system/tactiled@.service")
            finally:
                subprocess.run(["umount", str(root)], check=True)
            copy.rename(disk)
    return Image(disk, image.kernel, image.initrd)
