"""Wire protocol of ZeroMQ: the bytes of its specification, and any bytes in any pieces."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled.daemon.zmq import zmtp
from tactiled.daemon.zmq.zmtp import (
    Cancel,
    Greeted,
    Part,
    Ping,
    Ready,
    Refused,
    Subscribe,
    Value,
    ZmtpDecoder,
)

# Written by hand from rfc.zeromq.org/spec/37: what libzmq 4.3 sends as a SUB.
GREETING = bytes.fromhex("ff00000000000000017f 0301 4e554c4c" + "00" * 16 + "00" + "00" * 31)
READY = b"\x04\x19" + b"\x05READY" + b"\x0bSocket-Type" + b"\x00\x00\x00\x03SUB"
SUBSCRIBE = b"\x04\x11" + b"\x09SUBSCRIBE" + b"tactile"
CANCEL = b"\x04\x0e" + b"\x06CANCEL" + b"tactile"
PING = b"\x04\x0a" + b"\x04PING" + b"\x00\x0a" + b"abc"
OLD_SUBSCRIBE = b"\x00\x08" + b"\x01tactile"
OLD_CANCEL = b"\x00\x08" + b"\x00tactile"


def values_of(*pieces: bytes, longest_bytes: int = zmtp.LONGEST_BYTES) -> list[Value]:
    decoder = ZmtpDecoder(longest_bytes)
    return [value for piece in pieces for value in decoder.receive(piece)]


def test_a_session_as_libzmq_sends_it() -> None:
    assert values_of(GREETING + READY + SUBSCRIBE + PING + CANCEL) == [
        Greeted(), Ready("SUB"), Subscribe(b"tactile"), Ping(b"abc"), Cancel(b"tactile")
    ]  # fmt: skip


def test_a_subscription_of_version_3_0_is_a_message() -> None:
    _, _, *parts = values_of(GREETING + READY + OLD_SUBSCRIBE + OLD_CANCEL + b"\x00\x02hi" + b"\x00\x00")
    found = [zmtp.subscription(part) for part in parts if isinstance(part, Part)]
    assert found == [Subscribe(b"tactile"), Cancel(b"tactile"), None, None]


def test_parts_of_a_message_and_long_frames() -> None:
    long = b"\x02" + (300).to_bytes(8) + bytes(300)
    assert values_of(GREETING + READY + b"\x01\x01a" + long) == [
        Greeted(), Ready("SUB"), Part(b"a", True), Part(bytes(300), False)
    ]  # fmt: skip


def test_properties_have_any_order_and_any_case() -> None:
    body = b"\x05READY" + b"\x08Identity\x00\x00\x00\x02me" + b"\x0bsocket-TYPE\x00\x00\x00\x03SUB"
    assert values_of(GREETING + bytes((4, len(body))) + body) == [Greeted(), Ready("SUB")]


def test_unknown_commands_and_pongs_ask_for_nothing() -> None:
    assert values_of(GREETING + READY + b"\x04\x05\x04PONG" + b"\x04\x05\x04JOIN" + SUBSCRIBE) == [
        Greeted(), Ready("SUB"), Subscribe(b"tactile")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"GET / HTTP/1.1\r\n", "no greeting"),
        (b"\xff" + bytes(9), "no greeting"),
        (b"\xff" + bytes(7) + b"\x01\x7f\x01\x00", "old version"),
        (GREETING[:12] + b"CURVE".ljust(20, b"\0"), "'CURVE': connect without keys"),
        (GREETING + b"\x80", "flags 0x80"),
        (GREETING + b"\x05", "flags 0x05"),
        (GREETING + b"\x00\x01\x01", "a message before READY"),
        (GREETING + SUBSCRIBE, "no READY"),
        (GREETING + READY + READY, "second READY"),
        (GREETING + READY + b"\x04\x00", "without a name"),
        (GREETING + READY + b"\x04\x01\x00", "without a name"),
        (GREETING + READY + b"\x04\x02\x05P", "without a name"),
        (GREETING + b"\x04\x0a\x05READY\x0bSoc", "cut off"),
        (GREETING + b"\x04\x0a\x05ERROR\x03bad", "gave up: 'bad'"),
        (GREETING + READY + b"\x02" + (1025).to_bytes(8), "1025 bytes; 1024 are allowed"),
        (GREETING + READY + b"\x03" + b"\xff" * 8, "18446744073709551615 bytes"),
    ],
)
def test_what_is_no_subscriber_is_refused_once_and_keeps_nothing(data: bytes, says: str) -> None:
    decoder = ZmtpDecoder()
    *_, last = decoder.receive(data)
    assert isinstance(last, Refused)
    assert says in last.reason
    assert decoder.receive(SUBSCRIBE) == []
    assert not decoder._buffer  # noqa: SLF001  the bound on memory


def test_the_longest_frame_is_taken() -> None:
    prefix = bytes(1024 - 10)
    frame = b"\x06" + (1024).to_bytes(8) + b"\x09SUBSCRIBE" + prefix
    assert values_of(GREETING + READY + frame)[-1] == Subscribe(prefix)


FRAMES = st.one_of(
    st.sampled_from([SUBSCRIBE, CANCEL, PING, OLD_SUBSCRIBE, READY, b"\x04\x05\x04PONG"]),
    st.binary(max_size=40).map(lambda body: bytes((0, len(body))) + body),
    st.binary(max_size=20),
)
STREAMS = st.one_of(
    st.lists(FRAMES, max_size=12).map(lambda frames: GREETING + READY + b"".join(frames)),
    st.binary(max_size=200),
    st.integers(0, 63).flatmap(
        lambda at: st.integers(0, 255).map(
            lambda byte: GREETING[:at] + bytes([byte]) + GREETING[at + 1 :] + READY
        )
    ),
)


@given(stream=STREAMS, cuts=st.lists(st.integers(0, 300)))
def test_any_split_of_the_bytes_gives_the_same_values(stream: bytes, cuts: list[int]) -> None:
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    decoder = ZmtpDecoder(longest_bytes=64)
    values: list[Value] = []
    for begin, end in pairwise(places):
        values += decoder.receive(stream[begin:end])
        assert len(decoder._buffer) <= 64 + 9  # noqa: SLF001  the bound on memory
    assert values == values_of(stream, longest_bytes=64)
    assert values == values_of(*(stream[k : k + 1] for k in range(len(stream))), longest_bytes=64)
    assert not any(isinstance(value, Refused) for value in values[:-1])


@given(parts=st.lists(st.binary(max_size=600), min_size=1, max_size=4))
def test_what_we_encode_is_what_the_peer_decodes(parts: list[bytes]) -> None:
    values = values_of(zmtp.GREETING + zmtp.ready("PUB") + zmtp.message(*parts) + zmtp.pong(b"x"))
    expected = [Part(part, k < len(parts) - 1) for k, part in enumerate(parts)]
    assert values == [Greeted(), Ready("PUB"), *expected]


def test_our_greeting_and_answers_are_those_of_the_specification() -> None:
    assert GREETING == zmtp.GREETING
    assert zmtp.ready("SUB") == READY
    assert zmtp.pong(b"abc") == b"\x04\x08\x04PONGabc"
    assert zmtp.error("no") == b"\x04\x09\x05ERROR\x02no"
    assert zmtp.message(b"t", bytes(256)) == b"\x01\x01t" + b"\x02" + (256).to_bytes(8) + bytes(256)
