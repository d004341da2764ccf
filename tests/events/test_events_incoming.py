"""Received maps: what the codec emits passes as it is, and anything else is refused."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from message_strategies import instances
from messages import CONTACT, SLIP, anything

from tactiled.errors import ContractError
from tactiled.events.codec import to_map
from tactiled.events.incoming import checked_map
from tactiled.events.types import EVENT_TYPES, Event, ScanEvent, TextureEvent

KINDS = pytest.mark.parametrize("kind", EVENT_TYPES.values(), ids=EVENT_TYPES)


SAMPLES: dict[str, Event] = {
    "slip": SLIP,
    "contact": CONTACT,
    "texture": TextureEvent(time_s=0.0, status="low-snr", answered_s=0.0),
    "scan": ScanEvent(time_s=0.0, index=0, volts=(1.0,), valid=(True,), time_sd_s=0.0, age_s=0.0, late=False),
}


@pytest.mark.parametrize("topic", SAMPLES)
def test_what_the_codec_emits_passes_unchanged(topic: str) -> None:
    data = to_map(SAMPLES[topic], seq=3, board="TS1", unix_offset_s=1.7e9, run=7)
    assert checked_map(topic, data) == data


def test_values_that_no_calendar_or_text_takes_are_refused() -> None:
    data = to_map(CONTACT, seq=3, board="TS1", unix_offset_s=1.7e9)
    deep: Any = 1
    for _ in range(1000):
        deep = [deep]
    for odd in ({"timestamp": -1e11}, {"state": deep}):
        with pytest.raises(ContractError):
            checked_map("contact", data | odd)


@KINDS
@given(data=st.data())
@settings(deadline=None, max_examples=40)
def test_a_field_of_another_type_is_refused_and_a_missing_one_filled_or_refused(
    kind: type[Event], data: st.DataObject
) -> None:
    sent = to_map(data.draw(instances(kind)), seq=0, board="TS1", unix_offset_s=0.0)
    key = data.draw(st.sampled_from(sorted(sent)))
    without = {name: value for name, value in sent.items() if name != key}
    for broken in (without, {**sent, key: None}, {**sent, key: b"x"}):
        try:
            found = checked_map(kind.topic, broken)
        except ContractError:
            continue
        assert broken is without
        assert found.keys() == sent.keys()


@pytest.mark.parametrize(
    ("topic", "fields"),
    [
        ("scan", {"volts": [1.0, 2.0]}),
        ("scan", {"volts": [float("nan")]}),
        ("scan", {"valid": [1]}),
        ("scan", {"index": True}),
        ("slip", {"timestamp": 1e300}),
        ("slip", {"onset": float("inf")}),
        ("slip", {"taxels": 4}),
        ("texture", {"candidates": [{"period_mm": 1.0}]}),
    ],
)
def test_values_that_cannot_be_drawn_are_refused_with_the_name_of_the_field(
    topic: str, fields: dict[str, Any]
) -> None:
    data = to_map(SAMPLES[topic], seq=0, board="TS1", unix_offset_s=0.0)
    with pytest.raises(ContractError, match=next(iter(fields))):
        checked_map(topic, {**data, **fields})


def test_an_earlier_version_lacks_fields_with_a_default_and_a_later_one_has_more() -> None:
    data = to_map(SLIP, seq=0, board="TS1", unix_offset_s=0.0)
    earlier = {key: value for key, value in data.items() if key != "suppressed"}
    assert checked_map("slip", earlier) == data
    assert checked_map("slip", {**data, "later": b"x"}) == data


@given(st.text(max_size=8) | st.sampled_from(list(EVENT_TYPES)), anything(st.text()))
@settings(deadline=None)
def test_any_other_map_is_refused(topic: str, data: Any) -> None:
    if not isinstance(data, dict):
        return
    with pytest.raises(ContractError):
        checked_map(topic, data)
