"""Facts about the device of a port: users, permissions, latency timer, error counts.

Nothing here opens a port for reading or writing. The facts come from ``/dev``, ``/proc`` and ``/sys``, and
any of them may be missing (ptys, sockets, other kernels): the functions then return None or "", and never
raise.
"""

import contextlib
import errno
import fcntl
import grp
import os
import pwd
import struct
import termios
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports

BY_ID = Path("/dev/serial/by-id")
BY_PATH = Path("/dev/serial/by-path")
_SYS_TTY = Path("/sys/class/tty")
LEAST_LATENCY_MS = 1
"""Least value of the FTDI latency timer, milliseconds."""
_TIOCGICOUNT = 0x545D  # asm-generic/ioctls.h; termios has no name for it
# struct serial_icounter_struct (linux/serial.h): cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk,
# buf_overrun, and nine reserved.
_ICOUNTER = struct.Struct("20i")


def is_pty(fd: int) -> bool:
    """Return True for a pseudo-terminal, which has a program at its other end instead of a cable."""
    try:
        return os.ttyname(fd).startswith("/dev/pts/")
    except OSError:
        return False


def is_url(url: str) -> bool:
    """Return True for ``socket://...`` and the like, which are no devices of this host."""
    return "://" in url


# ---- latency -------------------------------------------------------------------------------------------


def latency_ms(url: str, sys_tty: Path = _SYS_TTY) -> int | None:
    """Return the FTDI latency timer of the adapter at `url` in milliseconds; None where there is none."""
    with contextlib.suppress(OSError, ValueError):
        return int(_timer(url, sys_tty).read_text())
    return None


def shorten_latency(url: str, sys_tty: Path = _SYS_TTY) -> int | None:
    """Set the latency timer to its least value if permitted; returns its value then, None for no timer."""
    before_ms = latency_ms(url, sys_tty)
    if before_ms is not None and before_ms > LEAST_LATENCY_MS:
        with contextlib.suppress(OSError):  # only root may write it; the udev rule sets it for all others
            _timer(url, sys_tty).write_text(f"{LEAST_LATENCY_MS}\n")
    return latency_ms(url, sys_tty)


def latency_warning(url: str, timer_ms: int | None) -> str:
    """Return a warning about a latency timer that bunches scans; empty when it does not."""
    if timer_ms is None or timer_ms <= LEAST_LATENCY_MS:
        return ""
    return (
        f"{url} hands over bytes every {timer_ms} ms only (latency_timer): install systemd/99-tactiled.rules "
        f"and plug it in again, or: echo 1 | sudo tee {_timer(url, _SYS_TTY)}"
    )


def _timer(url: str, sys_tty: Path) -> Path:
    return sys_tty / Path(url).resolve().name / "device/latency_timer"


# ---- error counts of the UART --------------------------------------------------------------------------


@dataclass(frozen=True)
class LineErrors:
    """Error counts of the UART's driver since it was loaded."""

    framing: int
    """Bytes without a stop bit; almost always the effect of a wrong baud rate."""
    overrun: int
    """Bytes lost in the adapter or the kernel because they were not read in time."""


def line_errors(fd: int) -> LineErrors | None:
    """Return the error counts of an open tty (TIOCGICOUNT); None where the driver keeps none."""
    buffer = bytearray(_ICOUNTER.size)
    try:
        fcntl.ioctl(fd, _TIOCGICOUNT, buffer)
    except OSError:
        return None
    counters = _ICOUNTER.unpack(buffer)
    return LineErrors(framing=counters[6], overrun=counters[7] + counters[10])


# ---- users of the device -------------------------------------------------------------------------------


def keep_others_out(fd: int) -> None:
    """Refuse further opens by anyone but root (TIOCEXCL); pyserial's lock binds only programs that use it.

    A pty is left open for others: its other end outlives this process, and would keep the mark of a daemon
    that was killed.
    """
    with contextlib.suppress(OSError, termios.error):
        if not is_pty(fd):
            fcntl.ioctl(fd, termios.TIOCEXCL)


def same_device(fd: int, url: str) -> bool:
    """Return True while the name leads to the device that is open; after a replug it may be another."""
    try:
        return Path(url).stat().st_rdev == os.fstat(fd).st_rdev
    except OSError:
        return False


def is_free(url: str) -> bool:
    """Return True for a device that exists, may be opened, and is not locked by a daemon."""
    try:
        fd = os.open(url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)  # as pyserial's exclusive=True
    except OSError:
        return False
    else:
        return True
    finally:
        os.close(fd)


def stable_name(url: str, folder: Path = BY_ID) -> Path | None:
    """Return the udev name of the adapter at `url`, or None.

    Names in `BY_ID` follow the adapter from one USB socket to another; those in `BY_PATH` follow the socket.
    """
    with contextlib.suppress(OSError):
        device = Path(url).resolve()
        return next((name for name in sorted(folder.iterdir()) if name.resolve() == device), None)
    return None


# ---- messages ------------------------------------------------------------------------------------------


def explain(url: str, error: Exception) -> str:
    """Return one line on why a port does not open, and what to do."""
    number = error.errno if isinstance(error, OSError) else None
    if is_url(url):
        return f"{url}: cannot be opened ({error}); is the other end up, and is the address right?"
    if number == errno.ENOENT:
        return f"{url}: no such port{available()}"
    if number in (errno.EAGAIN, errno.EBUSY):
        return f"{url}: busy, another program has it (another tactiled?); see who: lsof {url}"
    if number in (errno.EACCES, errno.EPERM):
        return f"{url}: permission denied; {permission(url)}"
    if number in (errno.ENXIO, errno.ENODEV, errno.EIO):
        return f"{url}: the device does not answer; unplug it and plug it in again"
    if not Path(url).is_char_device():
        return f"{url}: not a serial port{available()}"
    return f"{url}: cannot be opened: {error}"


def available() -> str:
    """Return the list of present ports, to be appended to a message."""
    names: list[str] = []
    with contextlib.suppress(OSError):  # udev removes the folder with the last adapter
        names = sorted(map(str, BY_ID.iterdir()))
    with contextlib.suppress(OSError, TypeError):  # TypeError: pyserial, of an adapter that goes meanwhile
        names = names or sorted(port.device for port in list_ports.comports())
    return f"; there are: {', '.join(names)}" if names else "; no serial port is plugged in"


def permission(url: str) -> str:
    """Return the group that may open the device, and the command that adds this user to it."""
    try:
        group = grp.getgrgid(Path(url).stat().st_gid).gr_name
        user = pwd.getpwuid(os.getuid()).pw_name
    except (OSError, KeyError):  # the node is gone, or an id has no name
        return f"see who may use it: ls -l {url}"
    return f"it belongs to group {group}: sudo usermod -aG {group} {user}, then log in again"
