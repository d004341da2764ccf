"""Playback of a recording on a pseudo-terminal, with its original timing, as input for any driver.

Bytes that the driver writes are read and discarded. Bytes that the driver does not read yet are held back;
none are lost. A loss of the port during the recording appears as a pause.
"""

import contextlib
import fcntl
import os
import select
import struct
import termios
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tactiled.errors import ConfigError, OperatorError
from tactiled.recording.chunks import Extent
from tactiled.recording.contents import Read
from tactiled.recording.reader import Reached, in_order, read_items

_POLL_S = 0.02
_SETTLE_S = 0.2  # drivers discard what they find just after opening
_EMPTY_LOOKS = 10  # in a row: bytes in transit through the kernel are in no queue that can be queried
_DRAIN_S = 5.0  # time for the driver to read the last bytes before the port disappears


@dataclass(frozen=True)
class PlaybackResult:
    """Number of bytes played, and the largest delay because the driver did not read (s)."""

    n_bytes: int
    latest_s: float


class PlaybackPace:
    """Wait so that recorded times pass at `speed` times real time; 0 never waits."""

    def __init__(
        self,
        speed: float,
        sleep: Callable[[float], None] = time.sleep,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._speed, self._sleep, self._monotonic = speed, sleep, monotonic
        self._origin_s: float | None = None

    def wait(self, time_s: float) -> None:
        """Sleep until the recorded time `time_s` is due."""
        if not self._speed:
            return
        now_s = self._monotonic()
        if self._origin_s is None:
            self._origin_s = now_s - time_s / self._speed
        if (rest_s := self._origin_s + time_s / self._speed - now_s) > 0:
            self._sleep(rest_s)


def play(
    paths: Sequence[Path], link: Path, speed: float = 1.0, reached: Reached | None = None
) -> PlaybackResult:
    """Play recordings on the pseudo-terminal `link`; playback begins when a driver opens it.

    Parameters
    ----------
    paths : sequence of Path
        Parts of a recording in any order.
    link : Path
        Name of the pseudo-terminal during the playback.
    speed : float
        1 is real time, 0 as fast as the driver reads.
    reached : callable, optional
        Called with the completed fraction, 0 to 1.

    Raises
    ------
    ConfigError
        The link cannot be made.
    DataError
        A file is not a recording.
    OperatorError
        The driver closed the port before the end.
    """
    paths = [path for path, _ in in_order(paths)]
    pace = PlaybackPace(speed)
    n_bytes, latest_s = 0, 0.0
    with _terminal(link) as (master, device):
        _wait_for_reader(master)
        for number, path in enumerate(paths):
            extent = Extent()
            for item in read_items(path, extent):
                if reached is not None:
                    reached((number + extent.share_read) / len(paths))
                if isinstance(item, Read) and item.data:
                    pace.wait(item.arrival_s)
                    began_s = time.monotonic()
                    _write_all(master, item.data, n_bytes)
                    latest_s = max(latest_s, time.monotonic() - began_s)
                    n_bytes += len(item.data)
        _drain(device)
    return PlaybackResult(n_bytes, latest_s)


@contextlib.contextmanager
def _terminal(link: Path) -> Iterator[tuple[int, str]]:
    """Open a raw pseudo-terminal: its master descriptor, and the device name to which `link` points."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        os.set_blocking(master, False)
        device = os.ttyname(slave)
        os.close(slave)  # while it is open here too, it is unknown whether the driver has opened it
        try:
            link.symlink_to(device)
        except OSError as error:
            raise ConfigError("link", [f"cannot make {link}: {error.strerror}"]) from None
        try:
            yield master, device
        finally:
            with contextlib.suppress(OSError):
                link.unlink()
    finally:
        os.close(master)


def _wait_for_reader(master: int) -> None:
    """Wait until the other end is open: until then, a pseudo-terminal reports a hang-up."""
    poll = select.poll()
    poll.register(master, select.POLLIN)
    while any(happened & select.POLLHUP for _, happened in poll.poll(0)):
        time.sleep(_POLL_S)
    time.sleep(_SETTLE_S)


def _write_all(master: int, data: bytes, n_before: int) -> None:
    poll = select.poll()
    poll.register(master, select.POLLIN | select.POLLOUT)
    while data:
        for _, happened in poll.poll():
            if happened & select.POLLHUP:
                raise OperatorError(f"the driver closed the port after {n_before} bytes; play again")
            if happened & select.POLLIN:
                _discard(master)
            if happened & select.POLLOUT:
                with contextlib.suppress(BlockingIOError):
                    data = data[os.write(master, data) :]


def _discard(master: int) -> None:
    with contextlib.suppress(OSError):
        os.read(master, 4096)


def _drain(device: str) -> None:
    """Wait until the driver has read everything: unread bytes are lost when the terminal closes."""
    slave = os.open(device, os.O_RDWR | os.O_NOCTTY)
    try:
        until_s = time.monotonic() + _DRAIN_S
        empty_looks = 0
        while empty_looks < _EMPTY_LOOKS and time.monotonic() < until_s:
            (waiting,) = struct.unpack("i", fcntl.ioctl(slave, termios.FIONREAD, bytes(4)))
            empty_looks = 0 if waiting else empty_looks + 1
            time.sleep(_POLL_S)
    finally:
        os.close(slave)
