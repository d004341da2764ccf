"""Typed messages: a typo fails the type checker, C++ reads what we send."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from messages import SLIP, STATUS

from tactiled.client import Message, SlipMessage, Topic
from tactiled.client.parse import message_of
from tactiled.client.typed import MESSAGE_TYPES
from tactiled.events import codec
from tactiled.events.types import EVENT_TYPES, Candidate, TextureEvent
from tools.interfaces import ROOT

GOOD = """
from tactiled.client import Client, ScanMessage, SlipMessage, Message

async def control() -> None:
    async with Client(topics=("slip", "scan")) as client:
        async for item in client:
            match item:
                case SlipMessage(data=slip) if slip["valid"] and slip["state"] == "onset":
                    taxels: list[int] = slip["taxels"]
                case ScanMessage(data=scan):
                    volts: float = scan["volts"][0]
                case Message(topic="slip", data=data):
                    print(data["state"])
"""
BAD = """
from tactiled.client import Client, SlipMessage, Subscription
from tactiled.client import SlippMessage  # attr-defined
Subscription(topics=("slipp",))  # arg-type
while True:
    item = Subscription().next_item()
    if isinstance(item, SlipMessage):
        item.data["sate"]  # typeddict-item
        print(item.data["state"] == "onst")  # comparison-overlap
        count: int = item.data["onset"]  # assignment
"""
READER = """
#include <iostream>
#include <iterator>
#include <vector>
#include <nlohmann/json.hpp>
#include "tactiled_events.hpp"

template <class Message> Message read() {
    unsigned length = 0;
    std::cin >> length;
    std::cin.get();
    std::vector<unsigned char> bytes(length);
    std::cin.read(reinterpret_cast<char*>(bytes.data()), length);
    return nlohmann::json::from_msgpack(bytes).get<Message>();
}

int main() {
    const auto slip = read<tactiled::Slip>();
    const auto status = read<tactiled::Status>();
    const auto texture = read<tactiled::Texture>();
    std::cout << (slip.state == tactiled::Slip::STATE_ONSET) << slip.valid << " " << slip.taxels.at(0) << " "
              << slip.direction_deg << " " << slip.board << " " << slip.TOPIC << "\\n"
              << status.sent.slip << " " << status.loss_known << "\\n"
              << texture.candidates.at(1).period_mm << " " << texture.status << "\\n";
}
"""


def test_each_topic_has_its_class() -> None:
    assert set(get_args(Topic)) == MESSAGE_TYPES.keys() == EVENT_TYPES.keys()


def test_a_received_message_has_the_class_of_its_topic() -> None:
    data = codec.to_map(SLIP, seq=3, board="b", unix_offset_s=100.0)
    slip = message_of("slip", data, 1.0, 101.0)
    assert isinstance(slip, SlipMessage)
    assert (slip.topic, slip.seq, slip.data["kind"]) == ("slip", 3, "gross")
    other = message_of("topic-of-a-later-version", data, 1.0, 101.0)
    assert type(other) is Message


def test_a_typo_fails_the_type_checker(tmp_path: Path) -> None:
    (tmp_path / "good.py").write_text(GOOD)
    (tmp_path / "bad.py").write_text(BAD)
    command = [sys.executable, "-m", "mypy", "--config-file=", "--strict", "--follow-imports=silent"]
    done = subprocess.run(
        [*command, "--no-error-summary", str(tmp_path / "good.py"), str(tmp_path / "bad.py")],
        capture_output=True, text=True, cwd=ROOT, timeout=240, check=False,
        env={**os.environ, "MYPY_CACHE_DIR": str(ROOT / ".mypy_cache" / "typed")},
    )  # fmt: skip
    found = set(re.findall(r"(\w+)\.py:(\d+): error: .*\[([\w-]+)\]", done.stdout))
    lines = enumerate(BAD.splitlines(), 1)
    expected = {("bad", str(number), line.split("# ")[1]) for number, line in lines if "# " in line}
    assert found == expected, done.stdout + done.stderr


def test_cpp_reads_our_messages(tmp_path: Path) -> None:
    missing = [] if shutil.which("c++") else ["c++"]
    if not Path("/usr/include/nlohmann/json.hpp").exists():
        missing.append("nlohmann-json3-dev")
    if missing and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {' and '.join(missing)}")
    (tmp_path / "reader.cpp").write_text(READER)
    flags = ["-std=c++17", "-O0", "-Wall", "-Wextra", "-Werror", "-I", str(ROOT / "protocols" / "cpp")]
    program = str(tmp_path / "reader")
    subprocess.run(["c++", *flags, "-o", program, str(tmp_path / "reader.cpp")], check=True, timeout=240)
    gratings = tuple(Candidate(period_mm=period_mm, angle_deg=0.0, weight=0.5) for period_mm in (1.0, 2.5))
    texture = TextureEvent(time_s=0.0, status="ambiguous", answered_s=0.5, candidates=gratings)
    stream = b""
    for event in (SLIP, STATUS, texture):
        _, payload = codec.encode(event, seq=0, board="TS0001", unix_offset_s=1.7e9)
        stream += f"{len(payload)}\n".encode() + payload
    done = subprocess.run([program], input=stream, capture_output=True, check=True, timeout=60)
    assert done.stdout.decode().splitlines() == ["11 4 30 TS0001 slip", "0 1", "2.5 ambiguous"]
