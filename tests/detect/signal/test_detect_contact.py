"""The contact gate on pressure alone."""

import numpy as np
import pytest
from contact_gate import ContactGate
from touches import Touch, contact_states

from tactiled.array import load_array
from tactiled.detect.signal.contact_gate import ContactParams
from tactiled.events.types import ContactEvent
from tactiled.samples.block import regular_block
from tactiled.wang2019.slip import PUBLISHED_CONTACT

WANG = load_array("wang2019-3x3")
QUIET_TOUCH = Touch(slide_s=99.0, stop_s=100.0)


def test_press_hold_lift() -> None:
    events = ContactGate(WANG, PUBLISHED_CONTACT).process(QUIET_TOUCH.block(WANG))
    assert contact_states(events) == ["loading", "holding", "none"]
    loading, holding, none = events
    # 0.5 V of 1.2 V is reached 0.42 s into the press.
    assert loading.time_s == pytest.approx(100.0 + 0.5 + 0.42, abs=0.02)
    assert 101.5 < holding.time_s < 102.1
    assert none.time_s == pytest.approx(110.0, abs=0.011)
    assert isinstance(loading, ContactEvent)
    assert loading.taxels  # the first to pass; all of them a few scans later
    assert isinstance(holding, ContactEvent)
    assert holding.taxels == tuple(range(9))


@pytest.mark.parametrize("level", [0.45, 0.55])
def test_pressure_about_the_threshold_does_not_chatter(level: float) -> None:
    noisy = level + 0.08 * np.random.default_rng(0).normal(size=(3000, 36))
    volts = np.clip(noisy, level - 0.19, None)
    states = contact_states(ContactGate(WANG, PUBLISHED_CONTACT).process(regular_block(volts, 100.0)))
    assert states.count("none") == 0


def test_one_taxel_is_enough() -> None:
    volts = QUIET_TOUCH.volts(WANG, 100.0)
    volts[:, :16] = 0.0
    volts[:, 20:] = 0.0
    events = ContactGate(WANG, PUBLISHED_CONTACT).process(regular_block(volts, 100.0))
    assert contact_states(events) == ["loading", "holding", "none"]
    assert all(isinstance(e, ContactEvent) and e.taxels == (4,) for e in events[:2])


@pytest.mark.parametrize("stuck_volts", [1.1, 2.9])
def test_what_one_side_reads_alone_is_no_contact(stuck_volts: float) -> None:
    volts = QUIET_TOUCH.volts(WANG, 100.0)
    volts[:, 17] = stuck_volts  # from before the touch to after it: a quarter of it is above the threshold
    block = regular_block(volts, 100.0, start_s=100.0)
    healthy = ContactGate(WANG, PUBLISHED_CONTACT).process(QUIET_TOUCH.block(WANG))
    events = ContactGate(WANG, PUBLISHED_CONTACT).process(block)
    assert contact_states(events) == ["loading", "holding", "none"]
    assert [e.time_s for e in events[1:]] == pytest.approx([e.time_s for e in healthy[1:]], abs=0.02)
    assert 100.5 < events[0].time_s <= healthy[0].time_s  # the others need not bear all of the threshold
    alone = ContactGate(WANG, PUBLISHED_CONTACT)
    assert [e for n in range(len(block)) for e in alone.process(block[n : n + 1])] == events


def test_channels_that_vanish_are_no_change_of_load() -> None:
    volts = QUIET_TOUCH.volts(WANG, 100.0)
    volts[500:, 3:20] = np.nan
    events = ContactGate(WANG, PUBLISHED_CONTACT).process(regular_block(volts, 100.0))
    assert contact_states(events) == ["loading", "holding", "none"]


def test_slow_loading_is_a_hold_and_fast_loading_is_not() -> None:
    for slope, expected in ((0.02, "holding"), (0.05, "loading")):
        volts = 0.6 + slope * np.arange(1000)[:, np.newaxis] / 100 + np.zeros(36)
        volts[0] = 0.0  # the touch is seen to begin
        states = contact_states(ContactGate(WANG, PUBLISHED_CONTACT).process(regular_block(volts, 100.0)))
        assert states[-1] == expected


def test_thresholds_are_parameters() -> None:
    params = ContactParams(contact_volts=2.0, release_volts=1.5)
    assert ContactGate(WANG, params).process(QUIET_TOUCH.block(WANG)) == []
