"""The inbox of C++ makes the same items of the same streams as that of Python, and reads every message."""

import json
import random
import subprocess
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgpack
import pytest
from cpp import ROOT, compile_native, need_native
from message_streams import RecordedInbox, native_outcome, record
from messages import SLIP, STATUS

from tactiled.client.catchup import HOLD_S
from tactiled.events import codec
from tactiled.events.endpoints import control_endpoint
from tactiled.events.types import TextureEvent

HELPERS = ROOT / "tests" / "helpers"
N_STREAMS, BLOCK = 200, 40


@pytest.fixture(scope="module")
def native_inbox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need_native()
    folder = tmp_path_factory.mktemp("native")
    return compile_native(HELPERS / "native_inbox.cpp", folder / "native_inbox", "-O1")


def play(program: Path, lines: Sequence[str]) -> list[Any]:
    """Outcomes of the inbox of C++."""
    done = subprocess.run(
        [program], input="\n".join(lines), capture_output=True, text=True, check=True, timeout=120
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def assert_same(program: Path, recorded: RecordedInbox) -> None:
    found = map(native_outcome, play(program, recorded.lines))
    for line, ours, native in zip(recorded.lines, recorded.outcomes, found, strict=True):
        assert native == ours, line[:200]


@pytest.mark.parametrize("first", range(0, N_STREAMS, BLOCK))
def test_both_inboxes_have_the_same_outcomes(native_inbox: Path, first: int) -> None:
    for seed in range(first, first + BLOCK):
        assert_same(native_inbox, record(seed))


def test_the_streams_have_every_kind_of_item_and_fault() -> None:
    found = Counter[str]()
    for seed in range(BLOCK):
        for outcome in record(seed).outcomes:
            found.update(row[0] for row in outcome["items"])
            found.update(f"{row[0]} {row[1].split()[0]}" for row in outcome["items"] if row[0] == "Stale")
            found["requests"] += len(outcome["unsent"])
    assert (
        min(found[kind] for kind in ("Message", "Recovered", "Lost", "Fresh", "Malformed", "requests")) >= 40
    )
    assert min(found[kind] for kind in ("Restarted", "Stale no", "Stale stalled:")) >= 10
    assert found["Stale reading"] >= 3


def frames_of(seq: int, board: str = "b", **status: Any) -> list[bytes]:
    event = replace(STATUS, **status)
    return list(codec.encode(event, seq=seq, board=board, unix_offset_s=1.7e9, run=7))


def test_a_hole_that_many_messages_wait_behind_is_given_up(native_inbox: Path) -> None:
    recorded = RecordedInbox()
    recorded.tick()
    recorded.answer(msgpack.packb({"v": 1, "id": "x", "do": "state", "messages": {}}))
    recorded.receive(frames_of(0))
    for seq in range(2, 4010):
        recorded.receive(frames_of(seq))
    recorded.now_s += HOLD_S
    recorded.tick()
    assert recorded.inbox.catch_up.lost == 1
    assert sum(row[0] == "Message" for outcome in recorded.outcomes for row in outcome["items"]) == 4009
    assert_same(native_inbox, recorded)


def test_messages_that_wait_for_a_lost_one_are_stale_and_recovered(native_inbox: Path) -> None:
    """No controller takes them for present ones, and none is left without data that count as fresh."""
    recorded = RecordedInbox(topics=("slip",))
    recorded.tick()
    (asked,) = recorded.send()
    recorded.answer(msgpack.packb({"v": 1, "id": asked["id"], "do": "state", "messages": {}}))
    for k in range(30):
        if k % 10 == 0:
            recorded.receive(frames_of(k // 10, time_s=recorded.now_s, uptime_s=recorded.now_s))
        if k != 1:
            recorded.receive([b"tactile/b/slip", msgpack.packb(GOOD | {"board": "b", "run": 7, "seq": k})])
        recorded.now_s += 0.01
        recorded.tick()
        assert recorded.outcomes[-1]["fresh"] == (k <= 20)
    recorded.now_s += HOLD_S
    recorded.tick()
    recorded.receive(frames_of(3, time_s=recorded.now_s, uptime_s=recorded.now_s))
    rows = [row for outcome in recorded.outcomes for row in outcome["items"]]
    assert [row[0] for row in rows] == ["Fresh", "Message", "Stale", "Lost", *["Recovered"] * 28, "Fresh"]
    assert_same(native_inbox, recorded)


@pytest.mark.parametrize("behind_s", [0.4, 16.0])
def test_a_backlog_shows_by_clocks_that_differ_in_rate(native_inbox: Path, behind_s: float) -> None:
    """After hours, and where the wall clock tells no backlog, because it was set."""
    recorded = RecordedInbox(now_s=0.0)
    for hour in range(10):
        recorded.now_s = 3600.0 * hour
        recorded.receive(frames_of(hour, time_s=recorded.now_s, uptime_s=3600.0 * (1 - 2e-4) * hour))
    uptime_s = 3600.0 * (1 - 2e-4) * hour - behind_s
    recorded.receive(frames_of(10, time_s=recorded.now_s, uptime_s=uptime_s))
    stale = [row for row in recorded.outcomes[-1]["items"] if row[0] == "Stale"]
    assert bool(stale) == (behind_s > 1.0)
    assert_same(native_inbox, recorded)


@pytest.mark.parametrize("wall_is_right", [True, False])
def test_data_are_fresh_again_after_the_daemons_host_slept(native_inbox: Path, wall_is_right: bool) -> None:
    """Its monotonic clock stood still for an hour; a wall clock that says old, too, keeps the data stale."""
    recorded, slept_s, fresh = RecordedInbox(now_s=0.0), 0.0, []
    for k in range(400):
        if k == 100:
            recorded.now_s, slept_s = recorded.now_s + 3600.0, 3600.0
        old_s = 0.0 if wall_is_right else slept_s
        recorded.receive(frames_of(k, time_s=recorded.now_s - old_s, uptime_s=recorded.now_s - slept_s))
        fresh.append(recorded.outcomes[-1]["fresh"])
        recorded.now_s += 0.1
    assert all(fresh[:100])
    assert not any(fresh[100:195])
    assert fresh[205:] == 195 * [wall_is_right]
    assert_same(native_inbox, recorded)


def test_many_boards_use_bounded_memory(native_inbox: Path) -> None:
    recorded = RecordedInbox(topics=("status",))
    for number in range(1100):
        recorded.receive(frames_of(0, f"b{number}"))
    assert recorded.inbox.malformed == 1100 - 1024
    assert_same(native_inbox, recorded)


GOOD: dict[Any, Any] = {"v": 1, "timestamp": 1.0, "seq": 0, "board": "TS0001", "run": 1, "detected": 1.0}


def with_field(packed: bytes) -> bytes:
    """Pack a good message with one more field, given as msgpack."""
    return b"".join([bytes([0x80 | len(GOOD) + 1]), msgpack.packb(GOOD)[1:], msgpack.packb("more"), packed])


def signed(name: str, form: int) -> bytes:
    """Pack a good message with one integer in a signed form, of 1, 2, 4 or 8 bytes."""
    key, value = msgpack.packb(name), GOOD[name]
    packed = bytes([0xD0 + form]) + value.to_bytes(1 << form, "big")
    return bytes(msgpack.packb(GOOD).replace(key + msgpack.packb(value), key + packed))


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"\xc1", b"\x80", b"\xdf\xff\xff\xff\xff", b"\xdd\xff\xff\xff\xff" * 1000, b"\x91" * 100_000,
        msgpack.packb(GOOD) + b"\0", msgpack.packb(GOOD)[:-1], msgpack.packb([1, 2]),
        msgpack.packb({**GOOD, 1: 2}), msgpack.packb({**GOOD, b"b": 2}),
        *(msgpack.packb(GOOD | {"v": v}) for v in (0, 2, True, 1.0, "1", [1], 2**64 - 1)),
        *(msgpack.packb(GOOD | {"seq": seq}) for seq in (-1, 0.0, True, 2**53, 2**63 - 1, 2**63, 2**64 - 1)),
        *(msgpack.packb(GOOD | {"run": run}) for run in (-1, 0, 2**63 - 1, 2**63, "a", None)),
        *(msgpack.packb(GOOD | {"timestamp": at}) for at in (1, float("nan"), float("inf"), -1e300, "now")),
        msgpack.packb(GOOD | {"timestamp": 0.5}, use_single_float=True),
        *(signed(name, form) for name in ("v", "seq", "run") for form in range(4)),
        msgpack.packb(GOOD).replace(b"\xa1v\x01", b"\xa1v" + b"\x91" * 1000 + b"\x90"),
        *(with_field(b"\x91" * n + b"\x90") for n in (1021, 1022, 1023, 1024)),
        *(with_field(b"\x91" * n + b"\xc0") for n in (1021, 1022, 1023, 1024)),
        with_field(b"\x81\x01\x01"), with_field(b"\x81\xc4\x01x\x01"), with_field(b"\x81\x90\x01"),
        with_field(b"\x82\xa1a\x01\xa1a\x02"), with_field(b"\x81\xa0\x01"), with_field(b"\xd9\x01x"),
        # Timestamps of msgpack, and other extensions
        *(with_field(b"\xd4" + bytes([type_]) + b"\0") for type_ in (0, 127, 128, 254)),
        *(with_field(ext) for ext in (b"\xd4\xff\0", b"\xd6\xff\0\0\0\0", b"\xd7\xff" + b"\xff" * 8)),
        *(with_field(b"\xc7" + ext) for ext in (b"\x0c\xff" + b"\0" * 12, b"\x0c\xff" + b"\xff" * 12)),
        *(with_field(b"\xc7" + ext) for ext in (b"\0\xff", b"\0\x05", b"\x03\x05abc")),
        # UTF-8: shortest forms, surrogates, the last code point, cut sequences
        *(with_field(bytes([0xA0 + len(text)]) + text) for text in (
            b"\xc0\x80", b"\xc1\xbf", b"\xc2\x80", b"\xdf\xbf", b"\xe0\x9f\xbf", b"\xe0\xa0\x80",
            b"\xed\x9f\xbf", b"\xed\xa0\x80", b"\xee\x80\x80", b"\xef\xbf\xbf", b"\xf0\x8f\xbf\xbf",
            b"\xf0\x90\x80\x80", b"\xf4\x8f\xbf\xbf", b"\xf4\x90\x80\x80", b"\xf5\x80\x80\x80",
            b"\xe2\x82", b"\xe2\x82a", b"\x80",
        )),
    ],
    ids=lambda payload: f"{len(payload)}-{payload[-12:].hex()}",
)  # fmt: skip
def test_both_refuse_the_same_bytes(native_inbox: Path, payload: bytes) -> None:
    recorded = RecordedInbox()
    recorded.receive([b"tactile/TS0001/slip", payload])
    recorded.receive([b"tactile/TS0001/slip", msgpack.packb(GOOD | {"seq": 3})])
    assert_same(native_inbox, recorded)


def test_both_refuse_the_same_values_of_each_head(native_inbox: Path) -> None:
    """Each head of msgpack before bytes that are too few, enough or too many, in a list and in a map."""
    rng, recorded = random.Random(0), RecordedInbox()
    for head in range(256):
        for n_bytes in (0, 1, 2, 3, 4, 5, 8, 9, 13, 17, 40):
            value = bytes([head]) + bytes(rng.choice((0, 1, 2, 65, 192, 254, 255)) for _ in range(n_bytes))
            for around in (b"", b"\x91", b"\x81\xa1k", b"\x81"):
                recorded.receive([b"tactile/TS0001/slip", with_field(around + value)])
    assert 500 < recorded.inbox.malformed < len(recorded.outcomes) - 500  # both kinds are among them
    assert_same(native_inbox, recorded)


def test_a_reply_is_cut_into_its_messages(native_inbox: Path) -> None:
    """Arrays with heads of every size, and a map with keys that no daemon sends."""
    recorded = RecordedInbox()
    recorded.tick()
    kept: dict[Any, Any] = {f"tactile/b/t{n}": GOOD | {"board": "b"} for n in range(20)}
    recorded.answer(
        msgpack.packb(
            {"v": 1, "id": "x", "do": "state", "messages": {"": GOOD, b"": 5, **kept, "slip": GOOD}}
        )
    )
    recorded.receive([b"tactile/b/status", msgpack.packb(GOOD | {"board": "b", "valid": True})])
    heads = {0: b"", 4: b"\x93", 8: b"\xdc\0\x03", 12: b"\xdd\0\0\0\x03"}  # of an array of three
    for seq, head in heads.items():
        recorded.receive([b"tactile/TS0001/slip", msgpack.packb(GOOD | {"seq": seq})])
        missed = b"".join(msgpack.packb(GOOD | {"seq": n, "pi": 1.0}) for n in range(seq - 3, seq))
        for request in recorded.send():
            reply = {"v": 1, "id": request["id"], "do": "events", "ok": True, "run": 1, "next_seq": seq}
            recorded.answer(
                bytes([0x87]) + msgpack.packb(reply)[1:] + msgpack.packb("messages") + head + missed
            )
    assert recorded.inbox.catch_up.recovered == 9
    assert_same(native_inbox, recorded)


@pytest.mark.parametrize(
    "odd",
    [
        *({"next_seq": value} for value in (-1, 0, 2, 2**64 - 1, 1.5, True, None)),
        *({"run": value} for value in (2, 1.0, True, None, -1)),
        *({"ok": value} for value in (False, 1, None)),
        *({"more": value} for value in (True, 1)),
        *({"id": value} for value in ("", "events-00c0ffee-9", 3, None)),
        *({"do": value} for value in ("state", "other", None)),
        *(
            {"messages": value}
            for value in ([], {}, None, [GOOD], [5, GOOD | {"seq": 2}, {}], {"slip": GOOD})
        ),
        *({"v": value} for value in (2, True)),
    ],
    ids=str,
)
def test_both_take_the_same_replies(native_inbox: Path, odd: dict[str, Any]) -> None:
    recorded = RecordedInbox()
    recorded.tick()
    (asked,) = recorded.send()
    recorded.answer(msgpack.packb({"v": 1, "id": asked["id"], "do": "state", "messages": {}}))
    for seq in (0, 4):
        recorded.receive([b"tactile/TS0001/slip", msgpack.packb(GOOD | {"seq": seq})])
    (asked,) = recorded.send()
    missed = [GOOD | {"seq": seq} for seq in (0, 1, 2, 1, 4, 5)]  # those of the hole count
    reply = {
        "v": 1,
        "id": asked["id"],
        "do": "events",
        "ok": True,
        "run": 1,
        "messages": missed,
        "next_seq": 4,
    }
    for _ in range(2):
        recorded.answer(msgpack.packb(reply | odd))
    recorded.now_s += 2 * HOLD_S
    recorded.tick()
    assert_same(native_inbox, recorded)


def packed_pairs(pairs: Sequence[tuple[Any, bytes]]) -> bytes:
    """Pack a map, whose keys may be repeated, of values that are packed already."""
    head = msgpack.Packer().pack_map_header(len(pairs))
    return bytes(head) + b"".join(msgpack.packb(key) + value for key, value in pairs)


def test_of_a_repeated_key_the_last_value_counts_in_the_place_of_the_first(native_inbox: Path) -> None:
    recorded = RecordedInbox()
    recorded.tick()
    counts = [("slip", 9), ("grip", 5), (b"slip", 4), ("slip", 3), ("grip", -9), ("scan", 2), ("grip", 7)]
    status = GOOD | {"board": "b", "valid": True, "timestamp": recorded.now_s + recorded.unix_offset_s}
    for first in (0, 2):  # the topics begin with the first status; the second shows that messages are missing
        sent = packed_pairs([(key, msgpack.packb(count + first)) for key, count in counts])
        fields = [(key, msgpack.packb(value)) for key, value in (status | {"seq": first // 2}).items()]
        repeated = [("valid", msgpack.packb(False)), ("seq", msgpack.packb(70)), ("sent", b"\x80"), *fields]
        recorded.receive([b"tactile/b/status", packed_pairs([*repeated, ("sent", sent)])])
    lost = [row for outcome in recorded.outcomes for row in outcome["items"] if row[0] == "Lost"]
    assert lost == [["Lost", "slip", "b", 2], ["Lost", "grip", "b", 2], ["Lost", "scan", "b", 2]]
    assert ["Fresh"] in recorded.outcomes[-2]["items"]
    assert_same(native_inbox, recorded)


def test_of_a_repeated_topic_in_a_reply_the_last_message_counts(native_inbox: Path) -> None:
    recorded = RecordedInbox()
    recorded.tick()
    recorded.receive([b"tactile/b/status", msgpack.packb(GOOD | {"board": "b", "valid": True})])
    found = (
        ("t/slip", 1, "a"),
        ("", 1, "b"),
        (b"t/grip", 9, ""),
        ("t/grip", 4, "c"),
        ("", 2, "d"),
        (b"", 9, ""),
    )
    messages = [
        (topic, msgpack.packb(GOOD | {"board": "b", "seq": seq, "texts": text})) for topic, seq, text in found
    ]
    messages += [("t/slip", msgpack.packb(5)), ("t/grip", msgpack.packb(GOOD | {"board": "b", "seq": 3}))]
    reply = [(key, msgpack.packb(value)) for key, value in (("v", 1), ("id", "x"), ("do", "state"))]
    recorded.answer(packed_pairs([*reply, ("messages", b"\x80"), ("messages", packed_pairs(messages))]))
    recovered = [row[1:5:3] for row in recorded.outcomes[-1]["items"] if row[0] == "Recovered"]
    assert recovered == [["", 2], ["grip", 3]]
    assert_same(native_inbox, recorded)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp://127.0.0.1:9872", "tcp://[::1]:9872", "tcp://127.0.0.1", "tcp://*:x1", "tcp://host:65535",
        "ipc:///run/tactiled/left/events.ipc", "ipc:///run/events/a.ipc", "ipc://events-events",
        "ipc://", "ipc://a", "inproc://events", "udp://1", "tcp://",
    ],
)  # fmt: skip
def test_requests_go_to_the_same_endpoint(native_inbox: Path, endpoint: str) -> None:
    assert play(native_inbox, [f"endpoint {endpoint}"]) == [control_endpoint(endpoint)]


def test_values_of_commands_are_those_of_msgpack(native_inbox: Path) -> None:
    (packed,) = play(native_inbox, ["pack"])
    assert msgpack.unpackb(bytes.fromhex(packed)) == {
        "true": True,
        "false": False,
        "whole": [0, 127, -1, -(2**63), 2**63 - 1, 2**64 - 1],
        "floats": [0.5, -1e300, 0.25],
        "texts": ["", "Gr\u00f6\u00dfe", "x" * 70_000],
        "map": {"a": [1.5], "b": []},
    }


READER = """
#include <fstream>
#include <iostream>
#include <iterator>
#include "tactiled_message.hpp"

template <class T> T read(const char* path)
{
    std::ifstream file(path);
    tactiled::Message message;
    message.topic = T::TOPIC;
    message.payload.assign(std::istreambuf_iterator<char>(file), {});
    T out;
    if (!message.read(out)) throw std::runtime_error(path);
    message.topic = "other";
    if (message.read(out)) throw std::runtime_error("read as another topic");
    return out;
}

int main()
{
    const auto slip = read<tactiled::Slip>("slip");
    const auto status = read<tactiled::Status>("status");
    const auto texture = read<tactiled::Texture>("texture");
    const auto scan = read<tactiled::Scan>("scan");
    std::cout << slip.state << slip.valid << slip.taxels.at(0) << slip.board << slip.direction_deg << " "
              << status.sent.slip << status.loss_known << " " << texture.candidates.at(1).period_mm << " "
              << scan.volts.at(1) << scan.valid.at(0) << scan.valid.at(1) << scan.index;
    tactiled::Message message;
    message.topic = "scan";
    tactiled::Scan out;
    for (const char* wrong : {"\\x80", "\\x81\\xA1v\\x01", "\\x93\\x01\\x02\\x03"}) {
        message.payload = wrong;
        std::cout << message.read(out);
    }
}
"""


def test_messages_are_read_into_structures(tmp_path: Path) -> None:
    need_native()
    (tmp_path / "reader.cpp").write_text(READER)
    program = compile_native(tmp_path / "reader.cpp", tmp_path / "reader")
    head = {"v": 1, "timestamp": 1.0, "seq": 0, "board": "b", "run": 1}
    gratings = [
        {"period_mm": period_mm, "angle_deg": 0.0, "weight": 0.5, "period_sd_mm": 0.0, "period_min_mm": 0.0,
         "period_max_mm": 0.0} for period_mm in (1.0, 2.5)
    ]  # fmt: skip
    texture = TextureEvent(time_s=0.0, status="ambiguous", answered_s=0.5)
    messages = {
        "slip": codec.to_map(SLIP, seq=0, board="b", unix_offset_s=1.7e9),
        "status": codec.to_map(STATUS, seq=0, board="b", unix_offset_s=1.7e9) | {"of a later version": [1]},
        "texture": codec.to_map(texture, seq=0, board="b", unix_offset_s=0.0) | {"candidates": gratings},
        "scan": {"late": False, "age_s": 0.1, "time_sd_s": 0.0, "valid": [True, False], "volts": [1.0, 2.5],
                 "index": 3, **head},
    }  # fmt: skip
    for topic, message in messages.items():
        repeated = ("index", msgpack.packb(8))  # the first value does not count
        pairs = [(key, msgpack.packb(value)) for key, value in message.items()]
        (tmp_path / topic).write_bytes(packed_pairs([repeated, *pairs]))
    done = subprocess.run([program], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "onset14b30 01 2.5 2.5103000"
