"""The client of C++ beside a real daemon and an emulated board, in processes of their own."""

import json
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import msgpack
import pytest
import zmq
from client_programs import Program, board, process
from cpp import ROOT, compile_native, need_native
from patience import PATIENCE_S
from ports import free_pair

from tactiled.events.types import EVENT_TYPES

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def native_client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need_native()
    source = ROOT / "tests" / "helpers" / "native_client.cpp"
    return compile_native(source, tmp_path_factory.mktemp("native") / "native_client")


def has(kind: str, *fields: str) -> Callable[[list[list[str]]], bool]:
    """Any line of a kind whose words, after `fresh`, begin so."""
    return lambda lines: any(words[0] == kind and [*fields] == words[2 : 2 + len(fields)] for words in lines)


def is_stale(lines: list[list[str]]) -> bool:
    """Return whether the newest state that was told is stale."""
    return [words[0] for words in lines if words[0] in ("Stale", "Fresh")][-1:] == ["Stale"]


@pytest.mark.parametrize(("transport", "waits"), [("ipc", "fd"), ("tcp", "next")])
def test_events_commands_and_a_restart(
    native_client: Path, tmp_path: Path, transport: str, waits: str
) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc" if transport == "ipc" else f"tcp://127.0.0.1:{free_pair()}"
    config = tmp_path / "tactiled.toml"
    config.write_text(
        f'port.url = "{tmp_path}/board"\n'
        f'[publish]\nendpoints = ["{endpoint}"]\nallow_commands_over_tcp = true\n'
    )
    client = Program(native_client, endpoint, waits)
    try:
        client.until(has("Stale"), "stale without a daemon")
        with board(tmp_path):
            with process("run", "--config", config):
                client.until(has("Fresh"), "fresh")
                client.until(has("Message", "slip"), "a slip")
                lines = client.until(has("Message", "grip"), "a grip message")
                scans = [words for words in lines if words[2:3] == ["scan"]]
                assert {words[-1] for words in scans} == {"36"}
                client.say("inhibit duration_s 1.0")  # a float without a fraction
                client.until(has("Message", "command"), "the command as an event")
                assert ["Reply", "1"] in client.until(has("Reply"), "a reply")
                client.say("inhibit duration_s -1")
                refused = client.until(lambda all_: sum(w[0] == "Reply" for w in all_) == 2, "a refusal")
                assert any(words[:2] == ["Reply", "0"] and "duration_s:" in words for words in refused)
                client.say("many")
                assert ["Many", "3000"] in client.until(has("Many"), "answers to many commands")
            # It may have said so before this process is told of the end; messages that waited come behind.
            client.until(is_stale, "stale without the daemon")
            first = len(client.lines)
            with process("run", "--config", config):
                lines = client.until(has("Restarted"), "the second run", first)
                second = first + [words[0] for words in lines].index("Restarted")
                client.until(has("Message", "scan"), "a scan of the second run", second)
                client.until(has("Fresh"), "fresh again", first)
                client.say("mark")
                client.until(has("Reply"), "a reply of the second run", first)
    finally:
        code = client.close()
    assert code == 0
    assert_in_order([line.split() for line in client.lines])


def assert_in_order(lines: list[list[str]]) -> None:
    """Messages of a topic have growing numbers in each run, without a hole; nothing is malformed or lost."""
    kinds = {words[0] for words in lines}
    assert kinds <= {"Message", "Recovered", "Restarted", "Stale", "Fresh", "Reply", "Many"}
    newest: dict[tuple[str, ...], int] = {}
    for words in lines:
        if words[0] == "Restarted":
            newest = {key: seq for key, seq in newest.items() if key[1] != words[2]}
        elif words[0] in ("Message", "Recovered"):
            key, seq = (words[2], words[3]), int(words[4])  # topic and board
            assert seq == newest.get(key, seq - 1) + 1, words
            newest[key] = seq


def test_a_client_with_keys_is_admitted_where_others_are_not(native_client: Path, tmp_path: Path) -> None:
    port, keys = free_pair(), tmp_path / "left.toml"
    with process("keys", "make", "left", "--folder", tmp_path / "keys", "--out", keys) as making:
        assert making.wait(PATIENCE_S) == 0
    config = tmp_path / "tactiled.toml"
    config.write_text(
        f'port.url = "{tmp_path}/board"\n'
        f'[publish]\nendpoints = ["tcp://0.0.0.0:{port}"]\nkeys = "{tmp_path}/keys"\n'
    )
    endpoint = f"tcp://127.0.0.1:{port}"
    client, stranger = Program(native_client, endpoint, "fd", keys), Program(native_client, endpoint, "fd")
    try:
        stranger.until(has("Stale"), "stale without a daemon")
        with process("run", "--config", config):
            client.until(has("Message", "status"), "a status")
            client.say("inhibit duration_s 0.5")
            client.until(lambda lines: ["Reply", "1"] in lines, "a reply")
    finally:
        assert client.close() == stranger.close() == 0
    assert {line.split()[0] for line in stranger.lines} == {"Stale"}


def test_files_that_are_no_secret_keys_are_refused_by_their_name(native_client: Path, tmp_path: Path) -> None:
    keys = tmp_path / "left.toml"
    no_z85 = "".join(f'{name}_key = "{40 * "~"}"\n' for name in ("public", "secret", "daemon"))
    for text, mode, words in (
        ("", 0o600, "public_key is missing"),
        ("", 0o644, "others can read"),
        (no_z85, 0o600, f"{keys}: a key is no text in Z85"),
    ):
        keys.write_text(text)
        keys.chmod(mode)
        done = subprocess.run(
            [native_client, "tcp://127.0.0.1:1", "fd", keys], capture_output=True, text=True, check=False
        )
        assert words in done.stderr


def test_a_topic_that_no_daemon_has_is_refused_by_its_name(native_client: Path) -> None:
    def listen(*topics: str) -> subprocess.CompletedProcess[str]:
        command = [str(native_client), "tcp://127.0.0.1:1", "fd", "", *topics]
        return subprocess.run(command, capture_output=True, text=True, input="", check=False)

    assert listen(*EVENT_TYPES).returncode == 0
    refused = listen("grip", "slips")
    assert refused.returncode != 0
    assert f"topics: no topic 'slips'; there are: {', '.join(EVENT_TYPES)}\n" in refused.stderr


COMMANDS = """
#include <iostream>
#include <thread>
#include "tactiled.hpp"

int main(int, char** argv)
{
    tactiled::Options options;
    options.control = argv[1];
    tactiled::Commander daemon("tcp://127.0.0.1:1", options);
    try {
        if (std::string(argv[2]) == "begin") {
            daemon.begin("object-changed");  // before the daemon is connected
            daemon.begin("friction", "value", 0.4);
            while (!daemon.poll()) {
            }
            daemon.begin("mark", "text", std::string(17000, 'x'));
        }
        if (std::string(argv[2]) == "away") {
            daemon.begin("object-changed");
            for (int k = 0; k < 100; ++k)
                daemon.begin("motion", "acceleration_m_s2", double(k));
            daemon.begin("friction", "value", 0.4);
            std::cout << "waits" << std::endl;
            while (!daemon.poll()) {
            }
            return 0;
        }
        for (;;) {
            daemon.begin("motion", "acceleration_m_s2", 9.81);
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
            daemon.poll();
        }
    } catch (const tactiled::Error& error) {
        std::cout << error.what() << std::endl;
    }
}
"""


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need_native()
    folder = tmp_path_factory.mktemp("commands")
    (folder / "commands.cpp").write_text(COMMANDS)
    return compile_native(folder / "commands.cpp", folder / "commands")


def test_commands_wait_for_the_connection_and_a_long_one_is_refused(commands: Path, tmp_path: Path) -> None:
    asked: list[str] = []
    with zmq.Context() as context, context.socket(zmq.ROUTER) as sock:
        control = f"ipc://{tmp_path}/control.ipc"
        sock.bind(control)
        with subprocess.Popen([commands, control, "begin"], stdout=subprocess.PIPE, text=True) as program:
            while program.poll() is None:
                if sock.poll(20):
                    who, payload = sock.recv_multipart()
                    request = msgpack.unpackb(payload)
                    asked.append(request["do"])
                    reply = {"v": 1, "id": request["id"], "ok": True, "reason": "", "run": 1}
                    sock.send_multipart([who, msgpack.packb(reply)])
            assert program.stdout is not None
            said = program.stdout.read()
    assert asked == ["object-changed", "friction"]
    assert said.startswith("mark: 17")
    assert "a request has at most 16128" in said


def test_of_the_motion_of_a_time_without_a_daemon_the_newest_is_sent(commands: Path, tmp_path: Path) -> None:
    control = f"ipc://{tmp_path}/control.ipc"
    asked: list[tuple[str, float | None]] = []
    with (
        zmq.Context() as context,
        context.socket(zmq.ROUTER) as sock,
        subprocess.Popen([commands, control, "away"], stdout=subprocess.PIPE, text=True) as program,
    ):
        assert program.stdout is not None
        assert program.stdout.readline() == "waits\n"
        sock.bind(control)
        while program.poll() is None:
            if sock.poll(20):
                who, payload = sock.recv_multipart()
                request = msgpack.unpackb(payload)
                asked.append((request["do"], request.get("acceleration_m_s2")))
                reply = {"v": 1, "id": request["id"], "ok": True, "reason": "", "run": 1}
                sock.send_multipart([who, msgpack.packb(reply)])
    assert asked == [("object-changed", None), ("motion", 99.0), ("friction", None)]


def test_a_loop_that_sends_commands_hears_that_no_daemon_replies(commands: Path, tmp_path: Path) -> None:
    control = f"ipc://{tmp_path}/nobody.ipc"
    done = subprocess.run(
        [commands, control, "motion"], capture_output=True, text=True, check=True, timeout=60
    )
    assert "nobody.ipc: no answer: No such file or directory; is tactiled running there?" in done.stdout


FILLED_S = 7.5  # of the scene `hold`
TOO_LATE_S = 0.5  # of a scan: longer than a hiccup of a busy host
LEAST_N = 3.6 / (0.45 * 1.1)  # load over friction, once it is filled; the press of 6 N does not bear that


@pytest.mark.alone
def test_the_example_holds_what_it_does_not_know(tmp_path: Path) -> None:
    need_native()
    example = compile_native(ROOT / "examples" / "hold.cpp", tmp_path / "hold")
    endpoint = f"ipc://{tmp_path}/events.ipc"
    config = tmp_path / "hold.toml"
    config.write_text(f'port.url = "{tmp_path}/board"\npublish.endpoints = ["{endpoint}"]\n')
    control = tmp_path / "control"
    scene = ("--scene", "hold", "--link", tmp_path / "board", "--control", f"unix://{control}", "--scans")
    with process("emulate", *scene) as emulator, ExitStack() as others:
        assert emulator.stdout is not None
        assert json.loads(emulator.stdout.readline())["what"] == "ready"
        controller = Program(example, control, endpoint)
        others.callback(controller.close)  # it ends with the scene, which needs the daemon
        others.enter_context(process("run", "--config", config))
        reports = (json.loads(line) for line in emulator.stdout)
        t0_s = next(report["t0_s"] for report in reports if report["what"] == "scene")
        scan = next(reports)
        while scan["what"] != "scan" or scan["began_s"] < t0_s + FILLED_S:
            if scan["what"] == "scan" and time.monotonic() - scan["began_s"] > TOO_LATE_S:
                pytest.skip("this host is too slow for an emulated board in real time")
            scan = next(reports)
        assert not scan["fallen"]
        assert controller.close() == 0
        words = controller.lines[-1].split()
        assert words[:2] == ["held", "with"]
        assert LEAST_N < float(words[2]) < 2.5 * LEAST_N
