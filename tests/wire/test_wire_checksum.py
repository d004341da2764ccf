"""Checksums against what the Rocksoft catalogue publishes, and against its definition."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.wire.checksum import CHECKSUMS

# width, poly, init, reflected, xorout, check over "123456789": catalogue of parametrised CRC algorithms.
CATALOGUE = {
    "crc-16/ibm-3740": (16, 0x1021, 0xFFFF, False, 0x0000, 0x29B1),
    "crc-16/xmodem": (16, 0x1021, 0x0000, False, 0x0000, 0x31C3),
    "crc-32/iso-hdlc": (32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xCBF43926),
}


def by_definition(name: str, data: bytes) -> int:
    """Remainder of the polynomial division, one bit at a time."""
    width, poly, register, reflected, xorout, _ = CATALOGUE[name]
    for byte in data:
        for bit in range(8):
            into = byte >> (bit if reflected else 7 - bit) & 1
            top = register >> (width - 1) & 1
            register = (register << 1) & ((1 << width) - 1)
            if into ^ top:
                register ^= poly
    if reflected:
        register = int(f"{register:0{width}b}"[::-1], 2)
    return register ^ xorout


def test_every_checksum_is_in_the_catalogue() -> None:
    assert CHECKSUMS.keys() == CATALOGUE.keys()


@pytest.mark.parametrize("name", CATALOGUE)
def test_check_value(name: str) -> None:
    assert CHECKSUMS[name].compute(b"123456789") == CATALOGUE[name][-1]
    assert 8 * CHECKSUMS[name].n_bytes == CATALOGUE[name][0]


@pytest.mark.parametrize("name", CATALOGUE)
@given(data=st.binary(max_size=100))
def test_equals_its_definition(name: str, data: bytes) -> None:
    assert CHECKSUMS[name].compute(data) == by_definition(name, data)
