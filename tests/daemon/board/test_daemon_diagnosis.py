"""Diagnosis of lines with known faults: the right cause for each, and none for a good line."""

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from boards import LAYOUT, SimBoard
from uart import received_at

from tactiled.array import load_array
from tactiled.daemon.board.diagnosis import HICCUP_S, LineWatch
from tactiled.doctor.board import frames_of
from tactiled.pipeline import Health, Pipeline
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Corrupt, Scan
from tactiled.wire.layout import Layout, load_layout

LEGACY = load_layout("legacy-9")
EMPTY = Pipeline(LAYOUT, load_array("wang2019-3x3")).health()
BAUD = LAYOUT.file.baud


def scans(layout: Layout, n: int = 400) -> list[bytes]:
    """Frames of a board that streams, noise of some counts in it."""
    rng = np.random.default_rng(0)
    encode = Encoder(layout).encode
    return [
        encode(Scan(k % 256, rng.integers(400, 900, layout.n_channels), ticks=k * 100 % 65536))
        for k in range(n)
    ]


def flipped(data: bytes, per_byte: float) -> bytes:
    rng = np.random.default_rng(1)
    octets = np.frombuffer(data, np.uint8).copy()
    hit = rng.random(len(octets)) < per_byte
    octets[hit] ^= (1 << rng.integers(0, 8, int(hit.sum()))).astype(np.uint8)
    return octets.tobytes()


class Line:
    """A watch behind a decoder, fed for four seconds as the daemon feeds it."""

    def __init__(self, parts: list[bytes], framing_errors: list[int] | None = None) -> None:
        layout = LAYOUT
        self.watch = LineWatch(layout.name, BAUD)
        decoder, reasons = Decoder(layout), Counter[str]()
        self.watch.reset(0.0)
        self.watch.count(EMPTY, None if framing_errors is None else 0, 0.0)
        for k, part in enumerate(parts):
            self.now_s = 4.0 * (k + 1) / len(parts)
            self.watch.received(part, self.now_s)
            reasons.update(f.reason for f in decoder.feed(part) if isinstance(f, Corrupt))
            errors = None if framing_errors is None else framing_errors[k]
            health = replace(
                EMPTY,
                bytes_in=decoder.framer.bytes_in,
                bytes_framed=decoder.framer.bytes_framed,
                bytes_discarded=decoder.framer.bytes_discarded,
                corrupt_by_reason=dict(reasons),
            )
            self.watch.count(health, errors, self.now_s)

    @property
    def fault(self) -> str:
        return self.watch.fault(self.now_s)


def test_a_good_line_has_no_fault_and_no_warning() -> None:
    line = Line(scans(LAYOUT))
    assert (line.fault, line.watch.warning()) == ("", "")


@pytest.mark.parametrize("sent_baud", [9600, 19200, 38400, 57600, 230400, 460800, 921600])
def test_a_wrong_baud_rate_is_the_likely_cause(sent_baud: int) -> None:
    received = [received_at(part, sent_baud, BAUD) for part in scans(LAYOUT, 200)]
    unsure = Line([part for part, _ in received]).fault
    assert "wrong baud rate (115200 configured) most likely" in unsure
    assert unsure.endswith("; stop tactiled, then run tactiled doctor: it looks for both")
    counted = np.cumsum([bad for _, bad in received]).tolist()
    line = Line([part for part, _ in received], counted)
    assert "wrong baud rate (115200 configured): the UART counts framing errors" in line.fault


def test_the_uart_model_receives_what_was_sent_at_the_same_rate() -> None:
    data = b"".join(scans(LAYOUT, 5))
    assert received_at(data, BAUD, BAUD) == (data, 0)
    assert received_at(data, BAUD * 1.02, BAUD) == (data, 0)  # two crystals differ by less


def test_clean_bytes_that_are_no_frames_are_another_protocol_where_the_uart_counts() -> None:
    rng = np.random.default_rng(2)
    parts = [rng.integers(0, 256, 90).astype(np.uint8).tobytes() for _ in range(400)]
    assert f"wrong protocol ({LAYOUT.name} configured); 115200 baud is right" in Line(parts, [0] * 400).fault
    assert "most likely" in Line(parts).fault


def test_intact_frames_of_another_version_are_not_noise() -> None:
    stranger = bytes.fromhex("037f050350c700")  # type 0x7f, checksum right
    assert "intact frames of another one or version" in Line([stranger * 10] * 100).fault


def test_a_console_is_quoted() -> None:
    fault = Line([b"[boot] waiting for image\r\n"] * 100).fault
    assert "this is text" in fault
    assert "waiting for image" in fault


def test_a_port_that_is_opened_anew_is_judged_by_its_own_bytes() -> None:
    line = Line([b"ets Jul 29 2019 rst:0x1 (POWERON_RESET) " * 5] * 20)
    assert "this is text" in line.fault
    watch, opened_s = line.watch, line.now_s + 1.0
    watch.reset(opened_s)
    for k in range(30):
        watch.received(b"\x00\xff", opened_s + k / 10)
        watch.count(replace(EMPTY, bytes_in=2 * k), None, opened_s + k / 10)
    fault = watch.fault(opened_s + 2.9)
    assert "no frame structure in it" in fault
    assert "text" not in fault


def test_heavy_noise_is_not_a_wrong_baud_rate() -> None:
    parts = []
    for part in scans(LAYOUT):
        octets = bytearray(part)
        octets[40] ^= 0x10  # inside the counts: no code byte of the stuffing
        parts.append(bytes(octets))
    assert "every frame is damaged: heavy noise" in Line(parts).fault


def test_noise_that_lets_most_frames_pass_is_a_warning() -> None:
    stream = flipped(b"".join(scans(LAYOUT)), 1e-3)
    line = Line([stream[k : k + 85] for k in range(0, 34000, 85)])
    assert line.fault == ""
    assert "% of the bytes are damaged: noise on the line" in line.watch.warning()


def test_the_rest_of_a_frame_that_had_begun_is_no_noise() -> None:
    stream = b"".join(scans(LAYOUT))[40:]
    line = Line([stream[k : k + 85] for k in range(0, 850, 85)])
    assert line.watch.warning() == ""


def test_a_flip_in_a_minute_is_no_warning() -> None:
    parts = scans(LAYOUT, 400)
    parts[17] = flipped(parts[17], 0.02)
    assert Line(parts).watch.warning() == ""


def test_silence_is_a_fault_after_a_second_until_the_first_frame() -> None:
    watch = LineWatch("x", BAUD)
    watch.reset(10.0)
    watch.count(EMPTY, None, 10.0)
    assert watch.fault(10.0 + HICCUP_S / 2) == ""
    assert "no bytes arrive" in watch.fault(10.0 + HICCUP_S)
    frame = Encoder(LAYOUT).encode(SimBoard().hello())
    watch.received(frame, 12.0)
    watch.count(replace(EMPTY, bytes_in=len(frame), bytes_framed=len(frame)), None, 12.0)
    assert watch.fault(12.1) == ""


def test_the_text_of_a_fault_is_constant() -> None:
    lines = [f"line {k} of a console that prints\r\n".encode() for k in range(100)]
    watch = LineWatch("x", BAUD)
    watch.reset(0.0)
    watch.count(EMPTY, None, 0.0)
    faults = set()
    for k, text in enumerate(lines):
        watch.received(text, k / 10)
        watch.count(replace(EMPTY, bytes_in=(k + 1) * len(text), bytes_discarded=k * len(text)), None, k / 10)
        faults.add(watch.fault(k / 10))
    assert len(faults - {""}) == 1


def test_unknown_frames_have_no_layout_name() -> None:
    assert frames_of(b"\x00\x01\x02" * 300, {"a": LAYOUT, "b": LEGACY}) is None
    assert frames_of(b"".join(scans(LEGACY, 3)), {"a": LAYOUT, "b": LEGACY}) == "b"


def overloaded(*, is_pty: bool, flags: bool = True) -> tuple[LineWatch, Health, float]:
    """A watch on ten seconds of intact frames, each fifth scan instant missed; what it counted, and when."""
    watch = LineWatch("x", BAUD)
    watch.reset(0.0, is_pty=is_pty)
    watch.count(EMPTY, None, 0.0)
    health, now_s = EMPTY, 0.0
    for k in range(1, 101):
        now_s, came, missed = k / 10, 8 * 85 * k, 2 * k
        watch.received(b"\0" * 85, now_s)
        overrun, dropped = (missed, 0) if flags else (0, missed)
        health = replace(
            EMPTY,
            bytes_in=came,
            bytes_framed=came,
            scans=8 * k,
            scans_missing=missed,
            scans_overrun=overrun,
            scans_dropped=dropped,
        )
        watch.count(health, None, now_s)
    return watch, health, now_s


CABLE = ("cable", "ground", "connectors", "noise", "powered", "swapped")


@pytest.mark.parametrize(
    ("is_pty", "advice"), [(False, "lower session.rate_hz"), (True, "its host is too slow or too busy")]
)
def test_a_board_that_flags_overruns_is_overloaded_and_its_cable_is_good(is_pty: bool, advice: str) -> None:
    watch, health, now_s = overloaded(is_pty=is_pty)
    warning = watch.warning()
    assert re.search(r"the board missed \d+ of its last \d+ scan instants", warning)
    assert advice in warning
    later_s = now_s + 27.0  # it fell silent: nothing else has changed
    watch.count(health, None, later_s)
    fault = watch.fault(later_s)
    assert "missed scan instants before" in fault
    assert advice in fault
    assert not [word for word in CABLE if word in warning + fault]


def test_a_board_on_a_port_that_is_opened_anew_is_not_called_overloaded_for_the_one_before() -> None:
    watch, health, now_s = overloaded(is_pty=False)
    watch.reset(now_s + 1.0)
    watch.count(health, None, now_s + 1.0)
    assert not watch.is_overloaded
    assert "is the board powered" in watch.fault(now_s + 3.0)


def test_scans_that_are_missing_between_intact_frames_are_not_blamed_on_the_cable() -> None:
    watch, _, _ = overloaded(is_pty=False, flags=False)
    assert "whole frames were left out, by a full buffer" in watch.warning()
    assert not [word for word in CABLE if word in watch.warning()]


def test_a_silent_pseudo_terminal_has_no_cable() -> None:
    watch = LineWatch("x", BAUD)
    watch.reset(0.0, is_pty=True)
    watch.count(EMPTY, None, 0.0)
    fault = watch.fault(27.0)
    assert fault.startswith("no bytes arrive: this port is a pseudo-terminal")
    assert "is it running, and is this host fast enough for it?" in fault
    assert not [word for word in CABLE if word in fault]


def test_a_board_that_has_sent_frames_has_no_swapped_lines() -> None:
    watch = LineWatch("x", BAUD)
    watch.reset(0.0)
    watch.count(EMPTY, None, 0.0)
    watch.received(b"\0" * 85, 1.0)
    one = replace(EMPTY, bytes_in=85, bytes_framed=85, scans=1)
    watch.count(one, None, 1.0)
    assert "any more" in watch.fault(3.0)
    assert "swapped" not in watch.fault(3.0)
    watch.reset(4.0)
    watch.count(one, None, 4.0)
    assert "swapped" in watch.fault(6.0)
