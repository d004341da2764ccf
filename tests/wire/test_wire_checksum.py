"""The checksum against what the Rocksoft catalogue publishes, and against its definition."""

from hypothesis import given
from hypothesis import strategies as st

from tactiled.wire.framing import crc16


def by_definition(data: bytes) -> int:
    """Remainder of the polynomial division, one bit at a time: width 16, poly 0x1021, init 0xFFFF."""
    register = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            into = byte >> bit & 1
            top = register >> 15
            register = (register << 1) & 0xFFFF
            if into ^ top:
                register ^= 0x1021
    return register


def test_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1


@given(data=st.binary(max_size=100))
def test_equals_its_definition(data: bytes) -> None:
    assert crc16(data) == by_definition(data)
