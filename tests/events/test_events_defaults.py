"""Fields with a default: an event that says no more than it must says that the rest is unknown."""

import dataclasses

import pytest

from tactiled.events.endpoints import control_endpoint
from tactiled.events.types import EVENT_TYPES, Candidate, Event, ForceEvent, Sent, new_event

# Every other default is 0, "", False or an empty tuple.
UNLIKE_ZERO = {
    ("grip", "utilisation_high"): 1.0,  # anything up to gross slip
    ("grip", "unit"): "relative",
    ("grip", "state"): "none",
    ("force", "fx_sd_n"): 1e9,
    ("force", "fy_sd_n"): 1e9,
    ("force", "fz_sd_n"): 1e9,
    ("force", "calibration"): "none",
    ("texture", "speed_source"): "none",
    ("status", "loss_known"): True,  # those of an ordinary board; earlier versions did not send them
    ("status", "damage_known"): True,
    ("status", "path"): "compiled",
}
KINDS = {**EVENT_TYPES, "sent": Sent, "candidate": Candidate}


@pytest.mark.parametrize("topic", KINDS)
def test_a_field_that_is_left_out_is_unknown_or_zero(topic: str) -> None:
    for field in dataclasses.fields(KINDS[topic]):
        if field.default is dataclasses.MISSING:
            continue
        if field.name == "sent":
            assert field.default == Sent()
        else:
            assert field.default == UNLIKE_ZERO.get((topic, field.name), type(field.default)())


def test_an_event_made_of_all_fields_is_the_one_of_the_constructor() -> None:
    plain = ForceEvent(time_s=1.5, fz_n=3.0, taxel_fz_n=(1.0, 2.0), valid=True)
    fields = {field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)}
    made = new_event(ForceEvent, **fields)
    assert made == plain
    assert hash(made) == hash(plain)


@pytest.mark.parametrize("topic", ["slip", "texture", "contact"])
def test_evidence_of_an_event_is_complete_at_the_instant_of_its_report(topic: str) -> None:
    times = {"time_s": 1.0, "onset_s": 0.5, "detected_s": 2.0, "answered_s": 3.0}
    kind = EVENT_TYPES[topic]
    names = [field.name for field in dataclasses.fields(kind)]
    event: Event = new_event(kind, **dict.fromkeys(names, 0.0) | times)
    assert event.evidence_s == {"slip": 2.0, "texture": 3.0, "contact": 1.0}[topic]


@pytest.mark.parametrize(
    ("endpoint", "control"),
    [
        ("tcp://127.0.0.1:9872", "tcp://127.0.0.1:9873"),
        ("tcp://[::1]:1", "tcp://[::1]:2"),
        ("tcp://host", ""),
        ("tcp://host:*", ""),
        ("tcp://host:٣", ""),
        ("ipc:///run/left/events.ipc", "ipc:///run/left/control.ipc"),
        ("ipc:///run/events/left", "ipc:///run/events/left.control"),
        ("ipc://left", "ipc://left.control"),
        ("ipc://", ""),
        ("inproc://events", ""),
        ("zenoh://host", "zenoh://host"),
    ],
)
def test_requests_have_the_endpoint_beside_that_of_events(endpoint: str, control: str) -> None:
    assert control_endpoint(endpoint) == control
