"""Fuzz what reads the line: `python tests/helpers/fuzz.py --seconds 3600`.

Streams of good frames, damaged in every way that lines damage and some that only people think of, and plain
noise go through the decoder of each shipped layout, in both directions, and through the whole pipeline. They
must never raise, read the same however they are cut, account for every byte, and bring out events that can be
told. A failure names its seed; --seed N runs that one stream again.
"""

import argparse
import random
import time
from collections.abc import Sequence

import numpy as np

from tactiled.array import load_array
from tactiled.events.codec import encode
from tactiled.events.types import Event
from tactiled.pipeline import Pipeline
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Frame, Hello, Scan
from tactiled.wire.layout import Layout, load_layout
from tactiled.wire.schema import Direction

ARRAYS = {"board-v1": "wang2019-3x3", "legacy-9": "normal-3x3"}
DIRECTIONS: tuple[Direction, ...] = ("board-to-host", "host-to-board")


def a_frame(rng: random.Random, layout: Layout, direction: Direction, k: int) -> bytes:
    """One good frame: mostly the next scan of a board, as its counters go."""
    encoder = Encoder(layout)
    if direction == "host-to-board" and layout.has("start"):
        name = rng.choice(["start", "stop", "set_rate", "ping", "identify"])
        return encoder.encode(Command(name, rng.randrange(256), rate_hz=rng.uniform(0.1, 1e4)))
    frame: Frame = Scan(
        k % (1 << (layout.bits("scan", "sequence") or 16)),
        np.array([rng.randrange(4096) for _ in range(layout.n_channels)]),
        ticks=(k * 10_000 + rng.choice([0, 0, 0, 1 << 31])) % (1 << (layout.bits("scan", "ticks") or 32)),
        flags=rng.choice([0, 0, 0, rng.randrange(1 << (layout.bits("scan", "flags") or 1))]),
    )
    if layout.has("hello") and rng.random() < 0.1:
        frame = Hello(
            board_serial=rng.choice(["TS0001", "X" * 16]),
            array_id=rng.choice(["wang2019-3x3", "other"]),
            rate_hz=rng.choice([100.0, 0.0, 1e-3, 4e6]),
            adc_bits=rng.choice([12, 0, 255]),
            adc_reference_v=rng.choice([3.0, 0.0, 60.0]),
            channel_offset_s=tuple(rng.uniform(0, 5e-3) for _ in range(layout.n_channels)),
            protocol_version=rng.choice([1, 1, 255]),
            firmware_version="f",
            boot_count=rng.randrange(65536),
            streaming=rng.random() < 0.5,
            ticks=rng.randrange(1 << 32),
        )
    elif layout.has("acknowledge") and rng.random() < 0.1:
        frame = Acknowledge(rng.randrange(256), "start", rng.choice(["ok", "busy"]), ticks=0)
    return encoder.encode(frame)


def damaged(rng: random.Random, data: bytes) -> bytes:
    """A frame as a bad line, or a bad mind, may leave it."""
    at, n = rng.randrange(len(data)), rng.randrange(1, 9)
    return rng.choice(
        (
            lambda: data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :],
            lambda: data[:at] + rng.randbytes(n) + data[at + n :],
            lambda: data[:at],
            lambda: data[:at] + data[at + n :],
            lambda: data[:at] + rng.randbytes(rng.randrange(1, 300)) + data[at:],
            lambda: data[: at + n] + data[at:],
            lambda: data[at:] + data[:at],
            lambda: data + data,
            lambda: bytes([rng.choice([0, 1, 2, 0x7E, 0xFF])]) * rng.randrange(1, 1500),
        )
    )()


def a_stream(rng: random.Random, layout: Layout, direction: Direction) -> bytes:
    parts = []
    k = rng.choice([0, 65530, rng.randrange(65536)])
    part_damaged = rng.choice([0.0, 0.1, 0.5, 1.0])
    for _ in range(rng.randrange(1, 40)):
        k += rng.choice([1, 1, 1, 1, 2, 300])
        part = a_frame(rng, layout, direction, k)
        parts.append(damaged(rng, part) if rng.random() < part_damaged else part)
    return b"".join(parts)


def cut(rng: random.Random, data: bytes) -> list[bytes]:
    longest = rng.choice([1, 7, 62, 4096])
    pieces = []
    while data:
        n = rng.randrange(1, longest + 1)
        pieces.append(data[:n])
        data = data[n:]
    return pieces


def decode(
    layout: Layout, direction: Direction, pieces: Sequence[bytes]
) -> tuple[list[Frame | Corrupt], Decoder]:
    decoder = Decoder(layout, direction)
    items = [item for piece in pieces for item in decoder.feed(piece)]
    decided = decoder.framer.bytes_framed + decoder.framer.bytes_discarded + decoder.framer.bytes_pending
    assert decoder.framer.bytes_in == decided == sum(map(len, pieces)), "bytes are not accounted for"
    return items, decoder


def check(seed: int) -> int:
    """Play the stream of this seed; gives its length."""
    rng = random.Random(seed)
    name = rng.choice(sorted(ARRAYS))
    layout, direction = load_layout(name), rng.choice(DIRECTIONS)
    data = a_stream(rng, layout, direction)
    pieces = cut(rng, data)
    whole, _ = decode(layout, direction, [data])
    assert decode(layout, direction, pieces)[0] == whole, "it reads otherwise when cut"
    pipeline, now_s = Pipeline(layout, load_array(ARRAYS[name])), 1000.0
    for piece in pieces:
        now_s += rng.choice([0.0, 1e-4, 0.01, 0.01, 5.0])
        for out in pipeline.receive_data(piece, now_s):
            if isinstance(out, Event):
                encode(out, seq=0, board="B", unix_offset_s=1.7e9)
        if rng.random() < 0.01:
            pipeline.disconnected()
    health = pipeline.health()
    assert health.bytes_in == health.bytes_framed + health.bytes_discarded + health.bytes_pending
    return len(data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, help="only this one")
    arguments = parser.parse_args()
    if arguments.seed is not None:
        check(arguments.seed)
        return
    until_s = time.monotonic() + arguments.seconds
    first = seed = time.time_ns() % (1 << 40)
    n_bytes = 0
    while time.monotonic() < until_s:
        try:
            n_bytes += check(seed)
        except BaseException:
            print(f"failed: python tests/helpers/fuzz.py --seed {seed}")
            raise
        seed += 1
    print(f"{seed - first} streams, {n_bytes} bytes: nothing raised, every byte is accounted for")


if __name__ == "__main__":
    main()
