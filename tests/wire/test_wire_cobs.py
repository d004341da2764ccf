"""COBS against the independent package of that name."""

from cobs import cobs as oracle
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tactiled.wire import cobs

# Runs around 254, where the code byte saturates, come rarely by chance alone.
RUNS = st.lists(
    st.one_of(
        st.binary(max_size=8),
        st.integers(250, 258).map(lambda n: b"\x55" * n),
        st.integers(1, 6).map(lambda n: b"\0" * n),
    ),
    max_size=6,
).map(b"".join)


@given(RUNS)
@example(b"")
@example(b"\x01" * 254)
@example(b"\x01" * 254 + b"\0")
@example(b"\x01" * 508)
@settings(deadline=None)
def test_encode_equals_the_oracle_and_comes_back(data: bytes) -> None:
    stuffed = cobs.encode(data)
    assert stuffed == oracle.encode(data)
    assert 0 not in stuffed
    assert len(stuffed) <= len(data) + 1 + max(len(data) - 1, 0) // 254
    assert cobs.decode(stuffed) == data


@given(
    st.one_of(
        st.binary(max_size=300), RUNS.map(cobs.encode), st.binary(max_size=6).map(lambda b: b"\xff" + b)
    )
)
@settings(deadline=None)
def test_decode_agrees_with_the_oracle_on_any_bytes(stuffed: bytes) -> None:
    try:
        expected = oracle.decode(stuffed)
    except oracle.DecodeError:
        expected = None
    assert cobs.decode(stuffed) == expected


@given(RUNS, st.binary(max_size=5))
@settings(deadline=None)
def test_prefixes_are_those_that_decode(data: bytes, behind: bytes) -> None:
    stuffed = cobs.encode(data) + behind
    found = dict(cobs.prefixes(stuffed, 0))
    for end in range(1, len(stuffed) + 1):
        decoded = cobs.decode(stuffed[:end])
        assert found.get(end) == (None if decoded is None else len(decoded))
