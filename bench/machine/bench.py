"""A whole robot host in a virtual machine: package, setup, boot, USB, clock, disk, memory, power cuts.

Debian 12 runs in qemu, which emulates the processor, with its own kernel, systemd, udev and ext4. The Debian
package of this checkout is installed in it, and `tactiled setup` sets it up; the same is done in Debian 13.
The emulated boards run on this host, behind the FTDI adapters that qemu emulates.
"""

import re
import subprocess
import tempfile
from contextlib import ExitStack
from pathlib import Path

from bench.machine import cases
from bench.machine.cases import Found
from bench.machine.guest import RATE_HZ, Board, Guest
from bench.machine.image import SUITES, make_image
from bench.report import (
    Aim,
    BenchOptions,
    aim,
    aims_table,
    at_most,
    load_words,
    median_aim,
    never,
    ratio,
)
from tactiled.progress import ProgressBar

_ROOT = Path(__file__).parents[2]
_TIMES, _QUICK_TIMES = 20, 2  # replugs, and copies of the disk
_CUTS, _QUICK_CUTS = 3, 1  # power cuts with a boot after each
_SWAPS, _QUICK_SWAPS = 4, 1
_AGE_S = 0.2  # the end of a scan, its time on the wire, and what a slow processor takes to read it
_OFFSET_MS = 5.0  # a step of less than 1 ms is not followed; reading two clocks takes the guest a millisecond
_RESUME_S = 5.0
_FIRST_S = 1.0  # a port is tried at least each 0.5 s (`daemon.serial.port`)


def _aims(found: Found, newer: Found) -> list[Aim]:
    """Judge what was found, and what was found in a newer Debian."""
    stepped, lost_by_step = max(found.stepped_s), found.clock.lost_with_board + abs(found.clock.unaccounted)
    over_own_boot = [fresh_s / found.own_boot_s for fresh_s in found.fresh_s]
    verifies = bool(found.verified) and all(found.verified)
    return [
        never("setup: configuration, unit, user, name of the port: missing", len(found.missing_files)),
        never("setup: no board found though one is there", found.setups_failed),
        at_most("latency timer of the adapter, set by the rule", 1, found.timer_ms, "d", " ms"),
        never("setup and --remove: files that differ", len(found.left_by_remove)),
        never("installed and purged: files that differ, without recordings", len(found.left_by_purge)),
        median_aim("first fresh scan over multi-user.target without the daemon", 1.1, over_own_boot, ".2f"),
        never("replugs: scans unaccounted for", abs(found.plugs.unaccounted)),
        never("replugs: scans lost with the adapter plugged in", found.plugs.lost_with_board),
        median_aim("replugs: device node to first scan (s)", _FIRST_S, found.replugged_s, ".2f"),
        at_most("adapter in another socket: the same", _FIRST_S, found.other_socket_s, ".2f", " s"),
        never("two adapters swapped: daemons with the wrong board", found.swapped),
        never("clock stepped: scans lost or unaccounted for", lost_by_step),
        at_most("clock stepped: until messages follow", 2, stepped, ".2f", " s"),
        never(
            "clock slewed by 1 % each way: scans lost or unaccounted for",
            found.slewed.lost_with_board + abs(found.slewed.unaccounted),
        ),
        at_most("the same: age of a scan when it arrives", _AGE_S, _worst(found.slewed.age_s), ".3f", " s"),
        at_most(
            "the same: error of the wall clock of messages",
            _OFFSET_MS,
            1e3 * abs(found.slewed_offset_error_s),
            ".1f",
            " ms",
        ),
        never("suspended to memory for 20 s: scans unaccounted for", abs(found.suspended.unaccounted)),
        at_most("resumed: until the first scan", _RESUME_S, found.resumed_s, ".2f", " s"),
        at_most("resumed: age of a scan when it arrives", _AGE_S, _worst(found.resumed_age_s), ".3f", " s"),
        at_most(
            "resumed: error of the wall clock of messages",
            _OFFSET_MS,
            1e3 * abs(found.suspended_offset_error_s),
            ".1f",
            " ms",
        ),
        never("disk full for 10 s: scans lost", found.full_disk_missing),
        at_most("disk has room again: until recorded", 15, found.recording_again_s, ".1f", " s"),
        never("64 MB of memory left for 30 s: scans lost", found.low_memory_missing),
        never("64 MB of memory left for 30 s: restarts", found.low_memory_restarts),
        aim("power cuts and boots: recordings that verify", "all", ratio(found.verified), verifies),
        aim(
            "disk as a power cut leaves it: recordings that verify",
            "all",
            ratio(found.copies_verified),
            bool(found.copies_verified) and all(found.copies_verified),
        ),
        at_most("the same: lost before the cut", 2, max(found.lost_by_cut_s), ".2f", " s"),
        never(f"{newer.system}: setup: missing", len(newer.missing_files)),
        never(f"{newer.system}: setup and --remove: files that differ", len(newer.left_by_remove)),
        never(f"{newer.system}: scans missing in the first 10 s", newer.first_missing),
    ]


def _worst(age_s: list[float]) -> float:
    """Largest age; infinite without scans, below zero if an instant is ahead of its arrival by more."""
    return max((abs(s) for s in age_s), default=float("inf"))


def bench_machine(progress: ProgressBar, options: BenchOptions) -> list[str]:
    """Install the package in the guest, and print what became of each case."""
    quick = options.quick
    times, swaps, cuts = (_QUICK_TIMES, _QUICK_SWAPS, _QUICK_CUTS) if quick else (_TIMES, _SWAPS, _CUTS)
    progress.note("disk of the guest, made once in some five minutes")
    found, newer = Found(), Found()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        board, other = (stack.enter_context(Board(folder, serial)) for serial in ("TS0001", "TS0002"))
        progress.note("Debian 13")
        with _guest(folder, "trixie") as guest:
            cases.install(guest, board, newer)
            cases.first_scans(guest, newer)
            guest.unplug(board)
        progress.note("installation")
        guest = stack.enter_context(_guest(folder, "bookworm"))
        before = cases.tree(guest)
        cases.install(guest, board, found)
        progress.note(f"{times} replugs")
        cases.replug(guest, board, times, found)
        progress.note("clock, disk, memory")
        cases.step_clock(guest, board, found)
        cases.slew_clock(guest, board, found)
        cases.fill_disk(guest, found)
        cases.fill_memory(guest, found)
        progress.note("two adapters")
        cases.swap(guest, board, other, swaps, found)
        progress.note("suspend")
        cases.suspend(guest, board, found)
        progress.note(f"{times} copies of the disk")
        cases.copy_disk(guest, times, folder, found)
        progress.note(f"{cuts} power cuts")
        cases.cut_power(guest, board, cuts, found)
        cases.boot_without(guest, board, found)
        cases.purge(guest, before, found)
    version = subprocess.check_output(["qemu-system-x86_64", "--version"], text=True)
    emulator = re.sub(r" \(.*", "", version.splitlines()[0].replace("QEMU emulator version", "qemu"))
    intro = (
        f"{found.system} in {emulator} without KVM, one emulated processor, on a host with {load_words()}; "
        f"boards at {RATE_HZ:g} Hz. {times} replugs, {swaps} swaps, {times} copies of the disk, "
        f"{cuts} power cuts. dpkg took "
        f"{found.install_s:.0f} s; multi-user.target is reached in {found.own_boot_s:.0f} s without "
        "the daemon. Seconds are of the guest."
    )
    changed = [
        f"Left by {name}: {', '.join(lines)}"
        for name, lines in (("--remove", found.left_by_remove), ("apt purge", found.left_by_purge))
        if lines
    ]
    return [intro, aims_table(_aims(found, newer)), *changed]


def _guest(folder: Path, suite: str) -> Guest:
    """Return a running guest with the package for it in its shared folder."""
    guest = Guest(make_image(suite), folder / suite)
    command = [str(_ROOT / "packages/debian/build"), "--python", SUITES[suite], "--out", str(guest.share)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    guest.boot()
    return guest
