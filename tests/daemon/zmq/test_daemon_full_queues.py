"""A peer that dies while our queue of its messages is full: libzmq's heartbeats would abort our process."""

import asyncio
import subprocess
import sys
import time
from pathlib import Path

from patience import PATIENCE_S

from tactiled.client import AsyncCommander

FLOODING_PUBLISHER = """
import sys, time, zmq
with zmq.Context() as context, context.socket(zmq.PUB) as sock:
    sock.bind(sys.argv[1])
    while True:
        for _ in range(300):
            sock.send_multipart([b"tactile/b/scan", bytes(600)])
        time.sleep(0.01)
"""
SLEEPING_SUBSCRIBER = """
import sys, time
from tactiled.client import Subscription
with Subscription(sys.argv[1]) as subscription:
    subscription.next_item()
    print("asleep", flush=True)
    sys.stdin.readline()
    print("awake", subscription.next_item() is not None, flush=True)
"""
FLOODING_CLIENT = """
import sys, zmq
with zmq.Context() as context, context.socket(zmq.DEALER) as sock:
    sock.linger = 0
    sock.connect(sys.argv[1])
    while True:
        sock.send(bytes(2000))
"""
SLOW_SERVER = """
import asyncio, sys
from dataclasses import replace
from tactiled.daemon.zmq import network, peers
network.BOUNDS = replace(network.BOUNDS, steps_per_s=25.0)
peers._BURST = 1
server = network.Network(network.PublishParams(endpoints=(sys.argv[1],)), [])
print("up", flush=True)
asyncio.run(server.run())
"""


def start(
    code: str, endpoint: str, stdin: int | None = None, stdout: int | None = None
) -> "subprocess.Popen[str]":
    return subprocess.Popen([sys.executable, "-c", code, endpoint], text=True, stdin=stdin, stdout=stdout)


def test_a_suspended_subscriber_survives_its_publisher(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    pipe = subprocess.PIPE
    with (
        start(FLOODING_PUBLISHER, endpoint) as publisher,
        start(SLEEPING_SUBSCRIBER, endpoint, stdin=pipe, stdout=pipe) as subscriber,
    ):
        try:
            assert subscriber.stdin is not None
            assert subscriber.stdout is not None
            assert subscriber.stdout.readline() == "asleep\n"
            time.sleep(1.5)  # its queue is full now
            publisher.kill()
            time.sleep(2.5)  # longer than a heartbeat would have been
            subscriber.stdin.write("\n")
            subscriber.stdin.flush()
            assert subscriber.stdout.readline() == "awake True\n"
            assert subscriber.wait(PATIENCE_S) == 0
        finally:
            publisher.kill()
            subscriber.kill()


def test_a_server_survives_clients_that_flood_it_and_leave(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/events.ipc"
    with start(SLOW_SERVER, endpoint, stdout=subprocess.PIPE) as server:
        try:
            assert server.stdout is not None
            assert server.stdout.readline() == "up\n"
            clients = [start(FLOODING_CLIENT, f"ipc://{tmp_path}/control.ipc") for _ in range(3)]
            time.sleep(1.0)
            for client in clients:
                client.kill()
                client.wait()
            time.sleep(1.5)
            assert server.poll() is None

            async def ask() -> bool:
                async with AsyncCommander(endpoint) as daemon:
                    return (await daemon.send("state", timeout_s=PATIENCE_S)).ok

            assert asyncio.run(ask())
        finally:
            server.kill()
