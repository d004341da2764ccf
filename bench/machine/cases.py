"""Cases of `bench machine`: what happens to the guest, and the measurements of each."""

import re
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from bench.machine.guest import Board, Guest
from bench.machine.records import Recorded, first_after, read_recording
from bench.processes import PYTHON
from tactiled.errors import OperatorError

UNIT = "tactiled@TS0001.service"
_CONFIG = "/etc/tactiled/TS0001.toml"
_PLACE = "/var/lib/tactiled/TS0001"
_METRICS_PORT = 9874
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
_PROGRAM = (*PYTHON, "tactiled")
_MOST_FAILED = 5  # more than that is no matter of a busy host


@dataclass
class Found:
    """All that was measured; times in seconds of the guest's clock."""

    system: str = ""
    own_boot_s: float = 0.0  # to multi-user.target, without tactiled
    fresh_s: list[float] = field(default_factory=list)  # start of the kernel to the first fresh scan
    install_s: float = 0.0
    timer_ms: int = 0  # latency timer of the adapter
    setups_failed: int = 0
    missing_files: list[str] = field(default_factory=list)  # which setup should have written
    first_missing: int = 0  # scans, in the first 10 s
    left_by_remove: list[str] = field(default_factory=list)
    left_by_purge: list[str] = field(default_factory=list)
    plugs: Recorded = field(default_factory=Recorded)
    replugged_s: list[float] = field(default_factory=list)  # device node to the first scan
    other_socket_s: float = 0.0
    swapped: list[bool] = field(default_factory=list)  # whether a daemon has the other's board
    clock: Recorded = field(default_factory=Recorded)
    stepped_s: list[float] = field(default_factory=list)  # clock stepped to messages with its new time
    slewed: Recorded = field(default_factory=Recorded)
    slewed_offset_error_s: float = 0.0  # wall clock of the messages beside that of the guest
    suspended: Recorded = field(default_factory=Recorded)
    suspended_offset_error_s: float = 0.0
    resumed_s: float = 0.0  # resume to the first scan taken after it
    resumed_age_s: list[float] = field(default_factory=list)  # of the scans after it, when they arrived
    full_disk_missing: int = 0
    recording_again_s: float = 0.0
    low_memory_missing: int = 0
    low_memory_restarts: int = 0
    verified: list[bool] = field(default_factory=list)  # recordings after cuts that were followed by a boot
    copied_unix_s: list[float] = field(default_factory=list)  # instants of copies, by the clock of the guest
    copies_verified: list[bool] = field(default_factory=list)  # recordings on copies of the disk
    lost_by_cut_s: list[float] = field(default_factory=list)  # end of that recording to the copy


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


def set_up(guest: Guest, found: Found, options: str = "") -> None:
    """Let `tactiled setup` find a board; on a busy host, scans may stall while it looks."""
    while guest.run(f"tactiled setup {options} && echo made || true").rpartition("\n")[2] != "made":
        found.setups_failed += 1
        if found.setups_failed > _MOST_FAILED:
            raise OperatorError(guest.run(f"tactiled setup {options}"))


def recorded(guest: Guest, board: Board, during: Callable[[], None]) -> Recorded:
    """Return what the daemon records from a new start to a stop, while something happens."""
    guest.unplug(board)  # qemu would keep what the board sends until the daemon has started
    guest.run(f"systemctl restart {UNIT}")
    guest.plug(board)
    wait_until_fresh(guest)
    during()
    guest.run(f"systemctl stop {UNIT}")
    newest = guest.run(f"ls -t {_PLACE}/*.mcap | head -n 1")
    guest.mount_share()
    guest.run(f"cp {newest} /mnt/newest.mcap; umount /mnt; systemctl start {UNIT}")
    return read_recording(guest.share / "newest.mcap")


def monotonic_s(guest: Guest) -> float:
    """CLOCK_MONOTONIC of the guest, which is never set and stands still while the guest is suspended."""
    return float(guest.run(_NOW))


def offset_error_s(guest: Guest, found: Recorded) -> float:
    """Wall clock less CLOCK_MONOTONIC, as recorded last, minus the guest's own (largest of 99 readings)."""
    both = guest.run(
        "python3 -c 'import time; print(max(time.time() - time.monotonic() for _ in range(99)))'"
    )
    return found.last_offset_s - float(both)


# ---- cases, in the order of their run -------------------------------------------------------------------


def install(guest: Guest, board: Board, found: Found) -> None:
    """Install the package, set the board up, undo that, and set it up again to record."""
    found.system = guest.run("echo Debian $(cat /etc/debian_version), Linux $(uname -r)")
    began_s = monotonic_s(guest)
    guest.mount_share()
    guest.run("dpkg --install /mnt/*.deb; umount /mnt")
    found.install_s = monotonic_s(guest) - began_s
    guest.plug(board)
    guest.until("test -e /dev/tactiled-TS0001")
    found.timer_ms = int(guest.run("cat /sys/bus/usb-serial/devices/ttyUSB0/latency_timer"))
    before = tree(guest)
    set_up(guest, found)
    wanted = (_CONFIG, "/dev/tactiled-TS0001", f"/etc/systemd/system/multi-user.target.wants/{UNIT}")
    checks = {path: f"test -e {path}" for path in wanted} | {
        "user": "id tactiled",
        "unit": f"systemctl is-active {UNIT}",
    }
    found.missing_files = [
        name
        for name, check in checks.items()
        if guest.run(f"{check} >/dev/null && echo there || true") != "there"
    ]
    guest.run("tactiled setup TS0001 --remove")
    found.left_by_remove = sorted(before ^ tree(guest))
    set_up(guest, found)
    guest.run(
        f"sed -i 's/^# directory/directory/' {_CONFIG}; "
        f"printf '\\n[metrics]\\nport = {_METRICS_PORT}\\n' >>{_CONFIG}; sync"
    )


def first_scans(guest: Guest, found: Found) -> None:
    """Count the scans missing in the first ten seconds of a daemon that setup has started."""
    guest.run(f"systemctl restart {UNIT}")
    wait_until_fresh(guest)
    time.sleep(10.0)
    found.first_missing = int(metrics(guest)[_MISSING])


def replug(guest: Guest, board: Board, times: int, found: Found) -> None:
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

    found.plugs = recorded(guest, board, plug_all)
    attached_s = since_boot_s(guest, "-k | grep 'now attached to ttyUSB'")[-len(sockets) :]
    *found.replugged_s, found.other_socket_s = [first_after(found.plugs.scan_s, s) for s in attached_s]


def swap(guest: Guest, board: Board, other: Board, times: int, found: Found) -> None:
    """Set a second board up, and let both adapters change their sockets and their order."""
    guest.plug(other, 2)
    guest.until("test -e /dev/tactiled-TS0002")
    by_id = guest.run("ls -d /dev/serial/by-id/*TS0002*")
    set_up(guest, found, f"--port {by_id} --tcp-port 9882")
    units = {board.serial: UNIT, other.serial: f"tactiled@{other.serial}.service"}
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
            found.swapped.append(f"board {one.serial} " not in state)
    guest.run(f"systemctl disable --now {units[other.serial]}")
    guest.unplug(other)


def step_clock(guest: Guest, board: Board, found: Found) -> None:
    """Set the wall clock an hour forward, then back."""
    at_s = []

    def step() -> None:
        for hours in ("+1", "-1"):
            time.sleep(5.0)
            at_s.append(monotonic_s(guest))
            guest.run(f"date -s '{hours} hour'")
        time.sleep(5.0)

    found.clock = recorded(guest, board, step)
    steps_s = [s for s, step_s in found.clock.steps_s if abs(abs(step_s) - _HOUR_S) < 1.0]
    found.stepped_s = [first_after(steps_s, s) for s in at_s]


def slew_clock(guest: Guest, board: Board, found: Found) -> None:
    """Let the clock run 1 % fast, then 1 % slow, as a time service does to correct it without a step."""

    def slew() -> None:
        for tick in (*_SLEWED_TICKS, _USUAL_TICK):
            # struct timex begins with `modes` (0x4000 is ADJ_TICK); `tick` is its twelfth number.
            guest.run(
                "python3 -c 'import ctypes, sys; numbers = (ctypes.c_long * 26)(0x4000); "
                f"numbers[11] = {tick}; sys.exit(ctypes.CDLL(None).adjtimex(numbers) < 0)'"
            )
            time.sleep(_SLEW_S)

    found.slewed = recorded(guest, board, slew)
    found.slewed_offset_error_s = offset_error_s(guest, found.slewed)


def suspend(guest: Guest, board: Board, found: Found) -> None:
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

    found.suspended = recorded(guest, board, sleep)
    found.suspended_offset_error_s = offset_error_s(guest, found.suspended)
    found.resumed_s = first_after(found.suspended.scan_s, resumed_s[0])
    pairs = zip(found.suspended.scan_s, found.suspended.age_s, strict=True)
    found.resumed_age_s = [age_s for scan_s, age_s in pairs if scan_s > resumed_s[0]]


def fill_disk(guest: Guest, found: Found) -> None:
    """Fill the disk while the daemon records, then make room."""
    wait_until_fresh(guest)
    before = metrics(guest)
    guest.run("fallocate -l $(df --output=avail -B 1 / | tail -n 1) /fill")
    guest.until(f"( {_SCRAPE} ) | grep -q 'tactiled_recording{{.*}} 0'")
    time.sleep(10.0)
    during = metrics(guest)
    found.full_disk_missing = int(during[_MISSING] - before[_MISSING])
    guest.run("rm /fill")
    began_s = monotonic_s(guest)
    guest.until(f"( {_SCRAPE} ) | grep -q 'tactiled_recording{{.*}} 1'")
    found.recording_again_s = monotonic_s(guest) - began_s


def fill_memory(guest: Guest, found: Found) -> None:
    """Leave 64 MB of memory for half a minute."""
    before = metrics(guest)
    guest.run(
        "mount -o remount,size=100% /dev/shm; "
        "fallocate -l $(awk '/MemAvailable/ { print 1024 * $2 - 64000000 }' /proc/meminfo) /dev/shm/fill"
    )
    time.sleep(30.0)
    after = metrics(guest)
    guest.run("rm /dev/shm/fill")
    found.low_memory_missing = int(after[_MISSING] - before[_MISSING])
    found.low_memory_restarts = int(guest.run(f"systemctl show -P NRestarts {UNIT}"))


def cut_power(guest: Guest, board: Board, times: int, found: Found) -> None:
    """Cut the power while the daemon records, and boot again; then verify all recordings."""
    guest.unplug(board)
    guest.run(f"systemctl stop {UNIT}; rm {_PLACE}/*; systemctl start {UNIT}")
    guest.plug(board)
    wait_until_fresh(guest)
    for number in range(times):
        time.sleep(5.0 + 0.73 * (number % 8))
        guest.cut_power()
        board.restart()
        guest.boot(board)
        wait_until_fresh(guest)
        found.fresh_s += since_boot_s(guest, f"-u {UNIT} | grep -m 1 'TS0001 running'")
    guest.until(f"test $(ls {_PLACE}/*.active | wc -l) -le 1")
    guest.run(f"systemctl stop {UNIT}")
    for name in guest.run(f"cd {_PLACE}; ls *.mcap").split():
        found.verified.append(
            "good" in guest.run(f"tactiled replay --verify {_PLACE}/{name} && echo good || true")
        )


def copy_disk(guest: Guest, times: int, folder: Path, found: Found) -> None:
    """Copy the disk at different times while the daemon records; recover and verify the recording of each."""
    wait_until_fresh(guest)
    for number in range(times):
        time.sleep(2.0 + 0.37 * (number % 11))
        asked_s = time.time()
        ahead_s = float(guest.run("date +%s.%N")) - (asked_s + time.time()) / 2
        time.sleep(0.29 * (number % 7))  # what the guest was asked has no part in the copy
        found.copied_unix_s.append(guest.copy_disk(folder / f"{number}.qcow2") + ahead_s)
    for number, cut_s in enumerate(found.copied_unix_s):
        copied = folder / f"{number}.qcow2"
        newest = max(_recovered(copied, folder / f"{number}"), key=lambda path: path.stat().st_mtime)
        verified = subprocess.run(
            [*_PROGRAM, "replay", "--verify", str(newest)], capture_output=True, check=False
        )
        found.copies_verified.append(verified.returncode == 0)
        found.lost_by_cut_s.append(cut_s - read_recording(newest).last_unix_s)


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


def boot_without(guest: Guest, board: Board, found: Found) -> None:
    """Boot as after the power cuts, but without the daemon."""
    guest.run("sync")
    guest.cut_power()
    guest.boot(board, masked_unit=UNIT)
    guest.until("systemctl is-active multi-user.target")
    reached = guest.run("systemctl show -P ActiveEnterTimestampMonotonic multi-user.target")
    found.own_boot_s = int(reached) * 1e-6


def purge(guest: Guest, before: set[str], found: Found) -> None:
    """Remove package and configuration; recordings and the user stay, as the page says."""
    guest.run("dpkg --purge tactiled")
    found.left_by_purge = sorted(line for line in before ^ tree(guest) if not _STAYS.search(line))
