"""First streams of the fuzzer, to show that it works; `.ci/run` runs it for a minute."""

import fuzz
import pytest

from tactiled.wire.codec import Decoder


def test_streams_of_the_fuzzer_pass() -> None:
    assert sum(map(fuzz.check, range(20))) > 4000


def test_a_law_that_is_broken_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    real = Decoder.feed
    monkeypatch.setattr(Decoder, "feed", lambda self, data: real(self, data[:-1]))
    with pytest.raises(AssertionError, match="bytes are not accounted for"):
        fuzz.check(0)
