"""Cases of `bench machine`: what happens to the guest, and the aims that are judged by it.

Times are seconds of the guest's clock, apart from those that a docstring names.
"""

import re
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.machine.guest import Board, Guest
from bench.machine.records import Recorded, first_after, read_recording
from bench.processes import PYTHON
from bench.report import Aim, aim, at_most, median_aim, never, over_runs, ratio
from tactiled.errors import OperatorError

UNIT = "tactiled@TS0001.service"
_ALL_UNIT = "tactiled.service"
CONFIG = "/etc/tactiled/TS0001.toml"
_PLACE = "/var/lib/tactiled/TS0001"
_METRICS_PORT = 9874
CONFIG_TEXT = f"""\
[port]
url = "/dev/tactiled-TS0001"
[board]
protocol = "board-v1"
array = "wang2019-3x3"
[session]
board_serial = "TS0001"
[record]
directory = "{_PLACE}"
[metrics]
port = {_METRICS_PORT}
"""
_SCRAPE = (
    f"exec 3<>/dev/tcp/127.0.0.1/{_METRICS_PORT}; printf 'GET /metrics HTTP/1.0\\r\\n\\r\\n' >&3; cat <&3"
)
# Rights, owners, sizes, names and targets of files, without logs, caches and what systemd and dpkg note.
_TREE = (
    r"find / -xdev -regextype egrep -regex '/var/(log|cache|lib/(systemd|dpkg))|(/var)?/tmp/.*' "
    r"-prune -o -type d -printf '%m %u:%g %p\n' -o -printf '%m %u:%g %s %p %l\n'"
)
# Recordings and the user stay after a purge.
_STAYS = re.compile(r" /var/lib/tactiled| /etc/(passwd|group|g?shadow)")
_MISSING = 'tactiled_scans_total{result="missing"}'
_HOUR_S = 3600.0
_NOW = """awk '/^now at/ { printf "%.3f", $3 / 1e9; exit }' /proc/timer_list"""
_SLEW_S = 30.0
_USUAL_TICK, _SLEWED_TICKS = 10_000, (10_100, 9_900)  # microseconds that each 10 ms add: 1 % each way
_SUSPENDED_S = 20.0
_BUSY_PROGRAMS, _BUSY_S = 4, 60.0
_PROGRAM = (*PYTHON, "tactiled")
_MOST_FAILED = 5  # more than that is no matter of a busy host
_AGE_S = 0.2  # the end of a scan, its time on the wire, and what a slow processor takes to read it
_OFFSET_MS = 5.0  # a step of less than 1 ms is not followed; reading two clocks takes the guest a millisecond
_RESUME_S = 5.0
_FIRST_S = 1.0  # a port is tried at least each 0.5 s (`daemon.serial.port`)
_LOST_S = 2.0  # a recording is synced each second


def tree(guest: Guest) -> set[str]:
    """Return a line for each file of the guest."""
    return set(guest.run(_TREE).splitlines())


def metrics(guest: Guest) -> dict[str, float]:
    """Return the metrics of the daemon, by name with labels apart from that of the board."""
    lines = [line.rpartition(" ") for line in guest.run(_SCRAPE).splitlines() if line.startswith("tactiled_")]
    return {
        name.replace('board="TS0001",', "").replace('{board="TS0001"}', ""): float(n) for name, _, n in lines
    }


def wait_until_fresh(guest: Guest, unit: str = UNIT) -> None:
    """Wait until the daemon says that its board runs."""
    guest.until(f"systemctl show -P StatusText {unit} | grep -q running")


def since_boot_s(guest: Guest, command: str) -> list[float]:
    """Return the times of lines of the journal since the start of the kernel."""
    lines = guest.run(f"journalctl -b -o short-monotonic {command}").splitlines()
    return [float(line.split("]")[0].strip(" [")) for line in lines]


def succeeds(guest: Guest, command: str) -> bool:
    """Return True where a command of the shell succeeds in the guest."""
    return guest.run(f"{{ {command}\n}} >/dev/null && echo yes || true").endswith("yes")


def set_up(guest: Guest, options: str = "") -> int:
    """Let `tactiled setup` find a board, and return how often it found none: on a busy host, scans stall."""
    for failed in range(_MOST_FAILED):
        if guest.run(f"tactiled setup {options} && echo made || true").rpartition("\n")[2] == "made":
            return failed
    raise OperatorError(guest.run(f"tactiled setup {options}"))


def recorded(guest: Guest, board: Board, during: Callable[[], None], unit: str = UNIT) -> Recorded:
    """Return what the daemon records from a new start to a stop, while something happens."""
    guest.unplug(board)  # qemu would keep what the board sends until the daemon has started
    # Alone in its folder: times of files are those of a clock that may be set back.
    guest.run(f"systemctl stop {unit}; rm -f {_PLACE}/*; systemctl start {unit}")
    guest.plug(board)
    wait_until_fresh(guest, unit)
    during()
    guest.run(f"systemctl stop {unit}")
    names = guest.run(f"ls {_PLACE}/*.mcap").split()
    if len(names) != 1:
        raise OperatorError(f"{unit} has made {len(names)} recordings: it was restarted meanwhile")
    copy = guest.copy_out(names[0])
    guest.run(f"systemctl start {unit}")
    return read_recording(copy)


def monotonic_s(guest: Guest) -> float:
    """CLOCK_MONOTONIC of the guest, which is never set and stands still while the guest is suspended."""
    return float(guest.run(_NOW))


def _unix_ahead_s(guest: Guest) -> float:
    """Wall clock of the guest less that of this host."""
    asked_s = time.time()
    return float(guest.run("date +%s.%N")) - (asked_s + time.time()) / 2


def _offset_error_ms(guest: Guest, found: Recorded) -> float:
    """Wall clock less CLOCK_MONOTONIC, as recorded last, against the guest's own (largest of 99 readings)."""
    both = guest.run(
        "python3 -c 'import time; print(max(time.time() - time.monotonic() for _ in range(99)))'"
    )
    return 1e3 * abs(found.last_offset_s - float(both))


def _worst(age_s: list[float]) -> float:
    """Largest distance of an instant from its arrival, either way; infinite without scans."""
    return max((abs(s) for s in age_s), default=float("inf"))


# ---- cases ----------------------------------------------------------------------------------------------


def install(guest: Guest) -> None:
    """Install the package of the shared folder."""
    guest.mount_share()
    guest.run("dpkg --install /mnt/*.deb; umount /mnt")


def set_up_board(guest: Guest, board: Board) -> list[Aim]:
    """Set the board up, undo that, and set it up again to record."""
    guest.plug(board)
    guest.until("test -e /dev/tactiled-TS0001")
    timer_ms = int(guest.run("cat /sys/bus/usb-serial/devices/ttyUSB0/latency_timer"))
    before = tree(guest)
    failed = set_up(guest)
    wanted = (CONFIG, "/dev/tactiled-TS0001", f"/etc/systemd/system/multi-user.target.wants/{UNIT}")
    checks = {path: f"test -e {path}" for path in wanted} | {
        "user": "id tactiled",
        "unit": f"systemctl is-active {UNIT}",
    }
    missing = [name for name, check in checks.items() if not succeeds(guest, check)]
    guest.run("tactiled setup TS0001 --remove")
    left = before ^ tree(guest)
    failed += set_up(guest)
    guest.run(f"printf '%s' '{CONFIG_TEXT}' >{CONFIG}; sync")
    return [
        never("setup: configuration, unit, user, name of the port: missing", len(missing)),
        never("setup: no board found though one is there", failed),
        at_most("latency timer of the adapter, set by the rule", 1, timer_ms, "d", " ms"),
        never("setup and --remove: files that differ", len(left)),
    ]


def first_scans(guest: Guest) -> list[Aim]:
    """Count the scans missing in the first ten seconds of a daemon that setup has started."""
    guest.run(f"systemctl restart {UNIT}")
    wait_until_fresh(guest)
    time.sleep(10.0)
    missing = int(metrics(guest)[_MISSING])
    guest.run(f"systemctl stop {UNIT}")
    verified = succeeds(guest, f"tactiled replay --verify {_PLACE}/*.mcap")
    return [
        never("scans missing in the first 10 s", missing),
        aim("its recording, verified there", "good", "good" if verified else "differs", verified),
    ]


def without_rights(guest: Guest) -> list[Aim]:
    """Let a user without rights, and one of group tactiled, try what they may and may not do."""
    nobody = "setpriv --reuid=nobody --regid=nogroup --clear-groups env HOME=/tmp"
    member = "setpriv --reuid=nobody --regid=nogroup --groups=tactiled env HOME=/tmp"
    wait_until_fresh(guest)
    may = [
        f"{nobody} tactiled listen --topic status --count 1 --timeout 60",
        f"{member} tactiled command state",
    ]
    may_not = [
        f"{nobody} tactiled command state --endpoint ipc:///run/tactiled/TS0001/events.ipc",
        f"{nobody} tactiled setup",
        f"{nobody} ls {_PLACE}",
        f"{nobody} head -c 1 /dev/tactiled-TS0001",
    ]
    refused = [not succeeds(guest, command) for command in may]
    allowed = [succeeds(guest, command) for command in may_not]
    return [
        never("user without rights (subscribe on loopback), member of the group (command): refused", refused),
        never("user without rights: command, setup, recordings, port: allowed", allowed),
    ]


def purge(guest: Guest, before: set[str]) -> tuple[list[Aim], list[str]]:
    """Remove package and configuration; recordings and the user stay, as the page says."""
    guest.run("dpkg --purge tactiled")
    left = sorted(line for line in before ^ tree(guest) if not _STAYS.search(line))
    return [never("installed and purged: files that differ, without recordings", len(left))], left


def replug(guest: Guest, board: Board, times: int) -> list[Aim]:
    """Pull the adapter out and plug it in again, each time after another time; then use the other socket."""
    sockets = [1] * times + [2]

    def plug_all() -> None:
        for number, usb_socket in enumerate(sockets):
            guest.unplug(board)
            guest.until("test ! -e /dev/tactiled-TS0001")
            time.sleep(0.1 + 0.37 * (number % 5))
            guest.plug(board, usb_socket)
            guest.until("test -e /dev/tactiled-TS0001")
            time.sleep(5.0)

    found = recorded(guest, board, plug_all)
    attached_s = since_boot_s(guest, "-k | grep 'now attached to ttyUSB'")[-len(sockets) :]
    *again_s, other_socket_s = [first_after(found.scan_s, s) for s in attached_s]
    return [
        never(f"{times} replugs: scans unaccounted for", abs(found.unaccounted)),
        never("replugs: scans lost with the adapter plugged in", found.lost_with_board),
        median_aim("replugs: device node to first scan (s)", _FIRST_S, again_s, ".2f"),
        at_most("adapter in another socket: the same", _FIRST_S, other_socket_s, ".2f", " s"),
    ]


def journal(guest: Guest) -> list[Aim]:
    """Look for tracebacks and a flood of lines in what the daemon has logged since the boot."""
    lines = guest.run(f"journalctl -b -o cat -u {UNIT}").splitlines()
    tracebacks = sum("Traceback" in line for line in lines)
    longest = max(len(line) for line in lines)
    return [
        never("journal: tracebacks", tracebacks),
        at_most("journal: longest line, without time and unit", 300, longest, "d", " characters"),
    ]


def swap(guest: Guest, board: Board, other: Board, times: int) -> list[Aim]:
    """Set a second board up, and let both adapters change their sockets and their order."""
    guest.unplug(board)  # from whichever socket
    guest.plug(board)
    guest.plug(other, 2)
    guest.until("test -e /dev/tactiled-TS0002")
    by_id = guest.run("ls -d /dev/serial/by-id/*TS0002*")
    set_up(guest, f"--port {by_id} --tcp-port 9882")
    units = {board.serial: UNIT, other.serial: f"tactiled@{other.serial}.service"}
    swapped = []
    for number in range(times):
        for one in (board, other):
            guest.unplug(one)
            guest.until(f"test ! -e /dev/tactiled-{one.serial}")
        pair = (other, board) if number % 2 == 0 else (board, other)
        for usb_socket, one in enumerate(pair, 1):
            guest.plug(one, usb_socket)
            guest.until(f"test -e /dev/tactiled-{one.serial}")
        for one in pair:
            wait_until_fresh(guest, units[one.serial])
            state = guest.run(f"systemctl show -P StatusText {units[one.serial]}")
            swapped.append(f"board {one.serial} " not in state)
    guest.run(f"systemctl disable --now {units[other.serial]}")
    guest.unplug(other)
    return [never("two adapters swapped: daemons with the wrong board", swapped)]


def step_clock(guest: Guest, board: Board) -> list[Aim]:
    """Set the wall clock an hour forward, then back."""
    at_s = []

    def step() -> None:
        for hours in ("+1", "-1"):
            time.sleep(5.0)
            at_s.append(monotonic_s(guest))
            guest.run(f"date -s '{hours} hour'")
        time.sleep(5.0)

    found = recorded(guest, board, step)
    steps_s = [s for s, step_s in found.steps_s if abs(abs(step_s) - _HOUR_S) < 1.0]
    followed_s = max(first_after(steps_s, s) for s in at_s)
    lost = found.lost_with_board + abs(found.unaccounted)
    return [
        never("clock stepped by an hour each way: scans lost or unaccounted for", lost),
        at_most("the same: until messages follow", 2, followed_s, ".2f", " s"),
    ]


def slew_clock(guest: Guest, board: Board) -> list[Aim]:
    """Let the clock run 1 % fast, then 1 % slow, as a time service does to correct it without a step."""

    def slew() -> None:
        for tick in (*_SLEWED_TICKS, _USUAL_TICK):
            # struct timex begins with `modes` (0x4000 is ADJ_TICK); `tick` is its twelfth number.
            guest.run(
                "python3 -c 'import ctypes, sys; numbers = (ctypes.c_long * 26)(0x4000); "
                f"numbers[11] = {tick}; sys.exit(ctypes.CDLL(None).adjtimex(numbers) < 0)'"
            )
            time.sleep(_SLEW_S)

    found = recorded(guest, board, slew)
    error_ms = _offset_error_ms(guest, found)
    lost = found.lost_with_board + abs(found.unaccounted)
    # What the emulated processor alone delays.
    at_rest = recorded(guest, board, lambda: time.sleep(_SLEW_S * (1 + len(_SLEWED_TICKS))))
    return [
        at_most("clock at rest: age of a scan when it arrives", _AGE_S, _worst(at_rest.age_s), ".3f", " s"),
        never("clock slewed by 1 % each way: scans lost or unaccounted for", lost),
        at_most("the same: age of a scan when it arrives", _AGE_S, _worst(found.age_s), ".3f", " s"),
        at_most("the same: error of the wall clock of messages", _OFFSET_MS, error_ms, ".1f", " ms"),
    ]


def suspend(guest: Guest, board: Board) -> list[Aim]:
    """Suspend the guest to memory while the board goes on, and resume it.

    The adapter is away meanwhile: qemu would keep what the board sends, which a real adapter drops.
    """
    resumed_s = []

    def sleep() -> None:
        time.sleep(5.0)
        guest.run(
            f"rm -f /run/resumed; ( sleep 2; echo mem >/sys/power/state; {_NOW} >/run/resumed ) >/dev/null &"
        )
        guest.until_suspended()
        guest.unplug(board)
        time.sleep(_SUSPENDED_S)
        guest.plug(board)
        guest.qmp("system_wakeup")
        guest.until("test -s /run/resumed")
        resumed_s.append(float(guest.run("cat /run/resumed")))
        time.sleep(15.0)

    found = recorded(guest, board, sleep)
    error_ms = _offset_error_ms(guest, found)
    pairs = zip(found.scan_s, found.age_s, strict=True)
    age_s = [age_s for scan_s, age_s in pairs if scan_s > resumed_s[0]]
    first_s = first_after(found.scan_s, resumed_s[0])
    return [
        never("suspended to memory for 20 s: scans unaccounted for", abs(found.unaccounted)),
        at_most("resumed: until the first scan", _RESUME_S, first_s, ".2f", " s"),
        at_most("resumed: age of a scan when it arrives", _AGE_S, _worst(age_s), ".3f", " s"),
        at_most("resumed: error of the wall clock of messages", _OFFSET_MS, error_ms, ".1f", " ms"),
    ]


def fill_disk(guest: Guest) -> list[Aim]:
    """Fill the disk while the daemon records, then make room."""
    wait_until_fresh(guest)
    before = metrics(guest)
    guest.run("fallocate -l $(df --output=avail -B 1 / | tail -n 1) /fill")
    guest.until(f"( {_SCRAPE} ) | grep -q 'tactiled_recording{{.*}} 0'")
    time.sleep(10.0)
    during = metrics(guest)
    guest.run("rm /fill")
    began_s = monotonic_s(guest)
    guest.until(f"( {_SCRAPE} ) | grep -q 'tactiled_recording{{.*}} 1'")
    again_s = monotonic_s(guest) - began_s
    return [
        never("disk full for 10 s: scans lost", int(during[_MISSING] - before[_MISSING])),
        at_most("disk has room again: until recorded", 15, again_s, ".1f", " s"),
    ]


def fill_memory(guest: Guest) -> list[Aim]:
    """Leave 64 MB of memory for half a minute."""
    wait_until_fresh(guest)
    before, restarts = metrics(guest), int(guest.run(f"systemctl show -P NRestarts {UNIT}"))
    guest.run(
        "mount -o remount,size=100% /dev/shm; "
        "fallocate -l $(awk '/MemAvailable/ { print 1024 * $2 - 64000000 }' /proc/meminfo) /dev/shm/fill"
    )
    time.sleep(30.0)
    after = metrics(guest)
    guest.run("rm /dev/shm/fill")
    restarts = int(guest.run(f"systemctl show -P NRestarts {UNIT}")) - restarts
    lost = int(after[_MISSING] - before[_MISSING])
    # A new process counts from 0, and knows nothing of the scans before it.
    words = f"{lost}" if not restarts else "not counted: the daemon was restarted"
    return [
        aim("64 MB of memory left for 30 s: scans lost", "none", words, not (lost or restarts)),
        never("64 MB of memory left for 30 s: restarts", restarts),
    ]


def load_processor(guest: Guest, board: Board, other: Board) -> list[Aim]:
    """Let programs compete for the processor with one daemon for a board, then with one for two boards."""
    busy = [f"busy-{number}" for number in range(_BUSY_PROGRAMS)]
    restarts = 0

    def compete() -> None:
        nonlocal restarts
        for unit in busy:
            guest.run(f"systemd-run --quiet --unit {unit} sh -c 'while :; do :; done'")
        time.sleep(_BUSY_S)
        guest.run(f"systemctl stop {' '.join(busy)}")
        # Before the unit is stopped: its next start counts from 0.
        restarts += sum(int(guest.run(f"systemctl show -P NRestarts {unit}")) for unit in (UNIT, _ALL_UNIT))

    found = [recorded(guest, board, compete)]
    other_config = CONFIG.replace(board.serial, other.serial)
    guest.run(
        f"sed s/{board.serial}/{other.serial}/ {CONFIG} >{other_config}; "
        f"install -d -o tactiled -g tactiled {_PLACE.replace(board.serial, other.serial)}; "
        f"systemctl disable --now {UNIT}; systemctl enable {_ALL_UNIT}"
    )
    guest.plug(other, 2)
    found.append(recorded(guest, board, compete, _ALL_UNIT))
    guest.run(f"systemctl disable --now {_ALL_UNIT}; systemctl enable --now {UNIT}; rm {other_config}")
    guest.unplug(other)
    aims = [never(f"{_BUSY_PROGRAMS} busy programs for {_BUSY_S:g} s, both units: restarts", restarts)]
    for unit, one in zip(("tactiled@", "tactiled.service with two boards"), found, strict=True):
        lost, late_s = one.lost_with_board + abs(one.unaccounted), float(np.percentile(one.age_s, 99))
        aims += [
            never(f"the same, {unit}: scans lost or unaccounted for", lost),
            at_most(f"the same, {unit}: age of 99 % of the scans when read", _AGE_S, late_s, ".3f", " s"),
        ]
    return aims


def cut_power(guest: Guest, board: Board, times: int) -> list[Aim]:
    """Cut the power while the daemon records, and boot again; then verify all recordings in the guest."""
    guest.unplug(board)
    guest.run(f"systemctl stop {UNIT}; rm -f {_PLACE}/*; systemctl start {UNIT}")
    guest.plug(board)
    wait_until_fresh(guest)
    cut_unix_s = []
    for number in range(times):
        time.sleep(5.0 + 0.73 * (number % 8))
        ahead_s = _unix_ahead_s(guest)
        time.sleep(0.31 * (number % 4))
        cut_unix_s.append(time.time() + ahead_s)
        guest.cut_power()
        board.restart()
        guest.boot(board)
        wait_until_fresh(guest)
    # The daemon recovers them, too, with what processor is left over, which here is little.
    guest.run(f"systemctl stop {UNIT}; tactiled recover {_PLACE}")
    paths = guest.run(f"ls {_PLACE}/*.mcap").split()[: len(cut_unix_s)]  # in the order of their beginnings
    verified = [succeeds(guest, f"tactiled replay --verify {path}") for path in paths]
    found = [read_recording(guest.copy_out(path)) for path in paths]
    guest.run(f"systemctl start {UNIT}")
    return [
        aim("power cuts and boots: recordings that verify", "all", ratio(verified), all(verified)),
        *_up_to_the_cut(cut_unix_s, found),
    ]


def copy_disk(guest: Guest, times: int, folder: Path) -> list[Aim]:
    """Copy the disk at different times while the daemon records; recover and verify the recording of each."""
    wait_until_fresh(guest)
    cut_unix_s, found, verified, difference = [], [], [], ""
    for number in range(times):
        time.sleep(2.0 + 0.37 * (number % 11))
        ahead_s = _unix_ahead_s(guest)
        time.sleep(0.29 * (number % 7))  # what the guest was asked has no part in the copy
        cut_unix_s.append(guest.copy_disk(folder / f"{number}.qcow2") + ahead_s)
    for number in range(times):
        copied = folder / f"{number}.qcow2"
        newest = max(_recovered(copied, folder / f"{number}"), key=lambda path: path.stat().st_mtime)
        done = subprocess.run(
            [*_PROGRAM, "replay", "--verify", str(newest)], capture_output=True, text=True, check=False
        )
        verified.append(done.returncode == 0)
        if done.returncode:
            difference = difference or f"; the first differs: {done.stdout} {done.stderr}"
        found.append(read_recording(newest))
    words = " ".join(f"{ratio(verified)}{difference}".split())[:500]
    return [
        aim("disk as a power cut leaves it: recordings that verify", "all", words, all(verified)),
        *_up_to_the_cut(cut_unix_s, found),
    ]


def _up_to_the_cut(cut_unix_s: list[float], found: list[Recorded]) -> list[Aim]:
    """Aims of recordings that were cut off, each at an instant by the wall clock of the guest."""
    lost_s = [cut_s - one.last_unix_s for cut_s, one in zip(cut_unix_s, found, strict=True)]
    is_met = max(lost_s) <= _LOST_S
    return [
        never("the same: scans missing before their last one", sum(one.lost_with_board for one in found)),
        aim("the same: lost before the cut (s)", f"at most {_LOST_S:g}", over_runs(lost_s, ".2f"), is_met),
    ]


def _recovered(copied: Path, folder: Path) -> list[Path]:
    """Recordings on a copy of the disk, after the journal of its file system and `tactiled recover`."""
    raw = copied.with_suffix(".raw")
    folder.mkdir()
    for command in (
        ["qemu-img", "convert", "-O", "raw", str(copied), str(raw)],
        ["e2fsck", "-E", "journal_only", "-p", str(raw)],
        ["debugfs", "-R", f"rdump {_PLACE} {folder}", str(raw)],
        [*_PROGRAM, "recover", str(folder / Path(_PLACE).name)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode not in ((0, 1) if command[0] == "e2fsck" else (0,)):  # 1: it has mended something
            raise OperatorError(f"{' '.join(command)}: {done.stderr}")
    raw.unlink()
    copied.unlink()
    return list((folder / Path(_PLACE).name).glob("*.mcap"))


def boot(guest: Guest, board: Board, times: int) -> list[Aim]:
    """Boot after power cuts with and without the daemon, in turn."""
    fresh_s: list[float] = []
    target_s: list[float] = []
    alone_s: list[float] = []
    for masked in ("", UNIT) * times:
        guest.run("sync")
        guest.cut_power()
        board.restart()
        guest.boot(board, masked_unit=masked)
        guest.until("systemctl is-active multi-user.target")
        if not masked:
            wait_until_fresh(guest)
            fresh_s += since_boot_s(guest, f"-u {UNIT} | grep -m 1 'TS0001 running'")
        reached = guest.run("systemctl show -P ActiveEnterTimestampMonotonic multi-user.target")
        (alone_s if masked else target_s).append(int(reached) * 1e-6)
    alone, target = float(np.median(alone_s)), float(np.median(target_s))
    return [
        median_aim(
            f"first fresh scan over multi-user.target without the daemon ({alone:.1f} s)",
            1.1,
            [s / alone for s in fresh_s],
            ".2f",
        ),
        median_aim(
            f"first fresh scan over multi-user.target of the same boot ({target:.1f} s)",
            1.1,
            [s / own_s for s, own_s in zip(fresh_s, target_s, strict=True)],
            ".2f",
        ),
    ]
