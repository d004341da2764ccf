"""board.md says what the layout and the C program say."""

import binascii
import re
import struct

import numpy as np
import pytest

from tactiled import resources
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Scan
from tactiled.wire.layout import load_layout
from tactiled.wire.schema import MessageLayout

PROSE = resources.shipped("protocols", "board.md").read_text()
LAYOUT = load_layout("board-v1")


def test_every_hex_dump_was_printed_by_the_c_program() -> None:
    golden = resources.shipped("protocols", "vectors", "board-v1.txt").read_text()
    printed = {line.split(" => ")[1] for line in golden.splitlines()}
    own_frames = PROSE.split("\n## Other firmware\n", 1)[0]
    dumps = ["".join(dump.split()) for dump in re.findall(r"```hex\n(.*?)```", own_frames, re.DOTALL)]
    assert len(dumps) == 3
    assert set(dumps) <= printed


@pytest.mark.parametrize("message", LAYOUT.file.messages, ids=lambda message: message.name)
def test_type_and_fields_are_in_the_prose_in_order(message: MessageLayout) -> None:
    name, id_ = message.name, message.id
    fields = [field.name for field in message.fields]
    size = LAYOUT.wire_bytes(name)
    if id_ < 0x10:
        section = PROSE.split(f"### `{name}`, type {id_:#04x}: {size} octets on the wire\n", 1)[1].split(
            "###"
        )[0]
        assert re.findall(r"^\| `(\w+)` \| (?:\d+ x )?(?:u\d+|text)", section, re.MULTILINE) == fields
    else:
        (row,) = re.findall(rf"^\| `{name}` \| {id_:#04x} \|(.*?)\| {size} \|", PROSE, re.MULTILINE)
        assert re.findall(r"`(\w+)`", row) == fields[1:]
        assert fields[0] == "token"


def test_results_and_flags_are_in_the_prose() -> None:
    for name, code in LAYOUT.file.results.items():
        assert f"| `{name}` | {code} |" in PROSE
    for name, bit in LAYOUT.file.flags.items():
        assert f"| `{name}` | {bit} ({1 << bit:#06x}) |" in PROSE


def test_the_timing_budget_adds_up() -> None:
    bits = 10 * LAYOUT.wire_bytes("scan")
    assert f"{0.95 * 115200 / bits:.2f} Hz at 115200 baud" in PROSE
    assert f"115 200 bit/s = {100 * 100 * bits / 115200:.1f} %" in PROSE


def test_legacy_scan_by_hand() -> None:
    """The frame as legacy-9.toml describes it, put together without our codec."""
    body = struct.pack(">B9HHB", 0x53, *range(1000, 1009), 65535, 255)
    guarded = body + struct.pack(">H", binascii.crc_hqx(body, 0xFFFF))
    assert b"\0" not in guarded
    frame = bytes([len(guarded) + 1]) + guarded + b"\0"
    scan = Scan(255, np.arange(1000, 1009), ticks=65535)
    layout = load_layout("legacy-9")
    assert Decoder(layout).feed(frame) == [scan]
    assert Encoder(layout).encode(scan) == frame
