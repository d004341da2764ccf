"""Process that is many boards: writes frames that were encoded beforehand to as many ptys.

Usage: ``python -m bench.boards.writer FOLDER N RATE_HZ LOG``. Board i is ``FOLDER/B000i``. Their scans are
spread evenly over the scan period. Commands are answered as the protocol wants it. Ends on SIGTERM; the log
(npz) then has, for each frame in the order of writing, its board, the time before writing, and how late that
was.
"""

import os
import selectors
import signal
import sys
import time
import tty
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Frame, Hello, Scan
from tactiled.wire.layout import load_layout

_LAYOUT = load_layout("board-v1")
_FRAMES = 20_000  # encoded beforehand: 200 s at 100 Hz
_ZERO_COUNTS, _NOISE_COUNTS = 1400, 2.0  # an untouched skin, with the noise of the emulated board
_TICKS_HZ = 1_000_000


def serial_of(number: int) -> str:
    """Return the serial number of a board."""
    return f"B{number:04d}"


def encoded_scans(rate_hz: float) -> list[bytes]:
    """Return consecutive scan frames of an untouched skin."""
    encoder, rng = Encoder(_LAYOUT), np.random.default_rng(0)
    shape = (_FRAMES, _LAYOUT.n_channels)
    counts = _ZERO_COUNTS + np.rint(_NOISE_COUNTS * rng.standard_normal(shape)).astype(np.int64)
    return [
        encoder.encode(Scan(k % 65536, row, ticks=round(k * _TICKS_HZ / rate_hz), flags=0))
        for k, row in enumerate(counts)
    ]


@dataclass
class _Board:
    serial: str
    master: int
    slave: int
    phase_s: float
    decoder: Decoder
    begin_s: float = 0.0
    """Time of the first scan; 0.0 while the board does not stream."""
    next_scan: int = 0


class _Writer:
    def __init__(self, folder: Path, n_boards: int, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._scans = encoded_scans(rate_hz)
        self._encoder = Encoder(_LAYOUT)
        self._boards = []
        for number in range(n_boards):
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            serial = serial_of(number)
            (folder / serial).symlink_to(os.ttyname(slave))
            phase_s = number / n_boards / rate_hz
            decoder = Decoder(_LAYOUT, "host-to-board")
            self._boards.append(_Board(serial, master, slave, phase_s, decoder))
        self.rows: list[tuple[int, float, float]] = []

    def run(self, ended: list[int]) -> None:
        """Answer commands and write scans until `ended` has an entry."""
        selector = selectors.DefaultSelector()
        for board in self._boards:
            selector.register(board.master, selectors.EVENT_READ, board)
        is_complete = False
        while not ended:
            now_s = time.monotonic()
            streaming = [number for number, board in enumerate(self._boards) if board.begin_s]
            if len(streaming) == len(self._boards) and not is_complete:
                is_complete = True
                print("all started", flush=True)
            due_s = min((self._due_s(self._boards[number]) for number in streaming), default=now_s + 0.05)
            for key, _ in selector.select(max(0.0, min(due_s - now_s, 0.05))):
                self._answer(key.data)
            for number in streaming:
                self._write_due(number)

    def _due_s(self, board: _Board) -> float:
        return board.begin_s + board.next_scan / self._rate_hz

    def _write_due(self, number: int) -> None:
        board = self._boards[number]
        due_s, now_s = self._due_s(board), time.monotonic()
        if now_s < due_s or board.next_scan >= len(self._scans):
            return
        if self._send(board, self._scans[board.next_scan]):
            self.rows.append((number, now_s, now_s - due_s))
        else:  # the daemon does not read: the scan is lost in the line
            self.rows.append((number, np.nan, now_s - due_s))
        board.next_scan += 1

    def _answer(self, board: _Board) -> None:
        try:
            data = os.read(board.master, 4096)
        except OSError:
            return
        for frame in board.decoder.feed(data):
            if not isinstance(frame, Command):
                continue
            now_s = time.monotonic()
            if frame.name == "start" and not board.begin_s:
                board.begin_s = np.ceil(now_s * self._rate_hz) / self._rate_hz + board.phase_s
            ticks = round(max(0.0, now_s - board.begin_s) * _TICKS_HZ) if board.begin_s else 0
            replies: list[Frame] = [Acknowledge(frame.token, frame.name, "ok", ticks=ticks)]
            if frame.name == "identify":
                replies.append(self._hello(board, ticks))
            for reply in replies:
                self._send(board, self._encoder.encode(reply))

    def _hello(self, board: _Board, ticks: int) -> Hello:
        return Hello(
            board_serial=board.serial,
            array_id="wang2019-3x3",
            rate_hz=self._rate_hz,
            adc_bits=12,
            adc_reference_v=3.0,
            channel_offset_s=(0.0,) * _LAYOUT.n_channels,
            protocol_version=_LAYOUT.file.protocol_version,
            firmware_version="bench",
            boot_count=1,
            streaming=board.begin_s > 0.0,
            ticks=ticks,
        )

    def _send(self, board: _Board, data: bytes) -> bool:
        try:
            return os.write(board.master, data) == len(data)
        except OSError:
            return False


def main(folder: Path, n_boards: int, rate_hz: float, log: Path) -> None:
    """Write until SIGTERM."""
    ended: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(1))
    writer = _Writer(folder, n_boards, rate_hz)
    print("ready", flush=True)
    writer.run(ended)
    board, time_s, late_s = np.array(writer.rows or [(0, np.nan, 0.0)]).T
    with log.open("wb") as out:
        np.savez(out, board=board.astype(np.int64), time_s=time_s, late_s=late_s)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), Path(sys.argv[4]))
