"""Messages of a daemon, and of a hostile publisher, for tests of client and daemon."""

from typing import Any

from hypothesis import strategies as st

from tactiled.events.types import ContactEvent, SlipEvent, StatusEvent

SLIP = SlipEvent(
    time_s=0.0, state="onset", kind="gross", onset_s=0.0, onset_sd_s=0.01, direction_deg=30.0,
    direction_sd_deg=2.0, confidence=1.0, taxels=(4,), detector="test", statistic=1.0, threshold=0.5,
    valid=True, detected_s=0.0,
)  # fmt: skip
CONTACT = ContactEvent(time_s=0.0, state="loading", previous="none", taxels=(), valid=True)
STATUS = StatusEvent(
    time_s=0.0, state="running", valid=True, reason="", warning="", age_s=0.01, clock_sd_s=0.0,
    clock_rate_ppm=0.0, rate_hz=100.0, scans=1, frames_corrupt=0, scans_missing=0, scans_duplicate=0,
    restarts=0, bytes_in=0, bytes_framed=0, bytes_discarded=0, bytes_pending=0, connects=1,
    contact="sliding", slipping=True, uptime_s=1.0,
)  # fmt: skip


def anything(keys: st.SearchStrategy[Any], max_size: int = 3) -> st.SearchStrategy[Any]:
    """Whatever msgpack can hold; its maps have these keys."""
    return st.recursive(
        st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=max_size),
        max_leaves=10,
    )
