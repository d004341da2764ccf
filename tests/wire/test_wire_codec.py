"""Values that do not fit: refused when we encode, reported when we decode; never wrapped, never raised."""

import dataclasses
import struct

import numpy as np
import pytest
from wire_strategies import BOARD_V1, LEGACY_9, decode

from tactiled import resources, tomlfile
from tactiled.errors import ContractError
from tactiled.wire import cobs
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Frame, Hello, Scan
from tactiled.wire.framing import crc16
from tactiled.wire.layout import compile_layout, load_layout
from tactiled.wire.schema import LayoutFile

SCAN = Scan(1, np.arange(36), ticks=2, flags=0)
HELLO = Hello("TB-1", "wang2019-3x3", 100.0, 12, 3.0, (0.0,) * 36, ticks=0)


@pytest.mark.parametrize(
    ("frame", "complaint"),
    [
        (dataclasses.replace(SCAN, sequence=65536), "scan.sequence: 65536 does not fit 0..65535"),
        (dataclasses.replace(SCAN, sequence=-1), "scan.sequence"),
        (dataclasses.replace(SCAN, ticks=2**32), "scan.ticks"),
        (dataclasses.replace(SCAN, ticks=None), "scan.ticks"),
        (dataclasses.replace(SCAN, counts=np.arange(35)), "scan.counts: has shape"),
        (dataclasses.replace(SCAN, counts=np.arange(1)), "scan.counts: has shape"),
        (dataclasses.replace(SCAN, counts=np.full(36, 65536)), "scan.counts"),
        (dataclasses.replace(HELLO, board_serial="x" * 17), "hello.board_serial: .* longer than 16 bytes"),
        (dataclasses.replace(HELLO, board_serial="Zürich"), "hello.board_serial: .* not printable ASCII"),
        (dataclasses.replace(HELLO, board_serial="a\0b"), "hello.board_serial: .* not printable ASCII"),
        (dataclasses.replace(HELLO, rate_hz=float("nan")), "hello.rate_hz"),
        (dataclasses.replace(HELLO, rate_hz=1e9), "hello.rate_hz"),
        (dataclasses.replace(HELLO, channel_offset_s=()), "hello.channel_offset_s: has shape"),
        (Acknowledge(1, "start", "perhaps", 0), "has no result 'perhaps'"),
        (Acknowledge(1, "dance", "ok", 0), "has no command 'dance'"),
        (Acknowledge(1, "0x100", "ok", 0), "acknowledge.command"),
        (Command("set_rate", 1, None), "set_rate.rate_hz"),
        (Command("dance", 1), "board-v1|tactiled-board has no message dance"),
    ],
)
def test_what_does_not_fit_is_refused(frame: Frame, complaint: str) -> None:
    with pytest.raises(ContractError, match=complaint):
        Encoder(BOARD_V1).encode(frame)


def test_a_layout_without_commands_refuses_them() -> None:
    with pytest.raises(ContractError, match="layout legacy-9 has no message start"):
        Encoder(LEGACY_9).encode(Command("start", 1))


def sealed(body: bytes) -> bytes:
    """An intact frame of board-v1 around any body."""
    return cobs.encode(body + crc16(body).to_bytes(2, "little")) + b"\0"


@pytest.mark.parametrize(
    "hello",
    [
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1.0", b"T\xe4t", b"a", 0, 0, 0, 100000, 12, 3000),
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1.0", b"a\0b", b"a", 0, 0, 0, 100000, 12, 3000),
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1\n0", b"a", b"a", 0, 0, 0, 100000, 12, 3000),
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1.0", b"a", b"a", 0, 0, 0, 0, 12, 3000),
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1.0", b"a", b"a", 0, 0, 0, 100000, 0, 3000),
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1.0", b"a", b"a", 0, 0, 0, 100000, 33, 3000),
        struct.pack("<BB12s16s24sHBIIBH72x", 2, 1, b"1.0", b"a", b"a", 0, 0, 0, 100000, 12, 0),
    ],
    ids=["not-ascii", "nul-inside", "control", "rate-0", "bits-0", "bits-33", "reference-0"],
)
def test_an_intact_hello_that_cannot_be_true_is_corrupt(hello: bytes) -> None:
    assert decode(BOARD_V1, sealed(hello))[0] == [Corrupt("value", len(hello))]


def test_an_acknowledge_of_strangers_keeps_their_numbers() -> None:
    body = struct.pack("<BHBBI", 3, 9, 0x7E, 200, 1)
    assert decode(BOARD_V1, sealed(body))[0] == [Acknowledge(9, "0x7e", "result 200", 1)]


def test_float_fields_carry_no_nan_further() -> None:
    document = tomlfile.read(resources.shipped("protocols", "board-v1.toml"))
    for field in document["messages"][1]["fields"]:
        if field["name"] in ("rate_hz", "adc_reference_v", "channel_offset_s"):
            field.update(type="f32", per_unit=1)
    layout = compile_layout(tomlfile.parse(document, LayoutFile, "floats"))
    good = Encoder(layout).encode(HELLO)
    assert decode(layout, good)[0] == [HELLO]
    with pytest.raises(ContractError, match=r"hello\.rate_hz"):
        Encoder(layout).encode(dataclasses.replace(HELLO, rate_hz=1e300))
    body = cobs.decode(good[:-1])
    assert body is not None
    for bad in (float("nan"), float("inf"), -1.0):
        assert decode(layout, sealed(body[:-2].replace(struct.pack("<f", 100.0), struct.pack("<f", bad))))[
            0
        ] == [Corrupt("value", len(body) - 2)]


def test_a_hello_without_a_version_has_that_of_its_layout() -> None:
    document = tomlfile.read(resources.shipped("protocols", "board-v1.toml"))
    document["protocol_version"] = 2
    hello = document["messages"][1]
    hello["fields"] = [field for field in hello["fields"] if field["name"] != "protocol_version"]
    layout = compile_layout(tomlfile.parse(document, LayoutFile, "second"))
    sent = dataclasses.replace(HELLO, protocol_version=2)
    assert decode(layout, Encoder(layout).encode(sent))[0] == [sent]


def test_a_missing_reading_is_nan_on_the_line() -> None:
    layout = load_layout("magnetometers-5")
    scan = Scan(0, np.array([float("nan"), *range(14)]))
    data = Encoder(layout).encode(scan)
    assert scan in decode(layout, 5 * data)[0]
    with pytest.raises(ContractError, match=r"(?s)scan\.counts: .* does not fit"):
        Encoder(layout).encode(Scan(0, np.full(15, float("inf"))))
