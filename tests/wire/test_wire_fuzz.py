"""First streams of the fuzzer, to show that it works; `.ci/run` runs it for a minute."""

import fuzz
import pytest

from tactiled.wire.codec import Decoder


@pytest.mark.parametrize("seed", range(0, 100, 50))
def test_streams_of_the_fuzzer_pass(seed: int) -> None:
    assert sum(fuzz.check(seed + k) for k in range(50)) > 10_000


def test_a_law_that_is_broken_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    real = Decoder.feed
    monkeypatch.setattr(Decoder, "feed", lambda self, data: real(self, data[:-1]))
    with pytest.raises(AssertionError, match="bytes are not accounted for"):
        fuzz.check(0)
