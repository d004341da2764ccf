"""Certificates of a fleet, against a real router with mutual TLS and access control."""

import json
import threading
from pathlib import Path

import pytest
import zenoh
from routers import free_port
from simulated_daemon import Rates, SimulatedDaemon
from zenoh_threads import zenoh_threads

from tactiled.client import Commander, Message, Subscription
from tactiled.client.over_zenoh import states
from tactiled.errors import ConfigError, OperatorError
from tactiled.zenoh.bridge import ZenohBridge, ZenohBridgeParams
from tactiled.zenoh.certificates import FleetMembers, make_fleet
from tactiled.zenoh.safety import bridge_config

__all__ = ["zenoh_threads"]  # a fixture for every test here


def secure_router(file: Path, port: int) -> "zenoh.Session":
    """The router as configured, at loopback instead of all interfaces."""
    config = json.loads(file.read_text())
    config["listen"]["endpoints"] = [f"tls/127.0.0.1:{port}"]
    config["transport"]["shared_memory"] = {"enabled": False}
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def test_members_do_what_they_may_and_no_more(tmp_path: Path) -> None:
    folder, port = tmp_path / "fleet", free_port()
    members = FleetMembers({"hall": f"127.0.0.1:{port}"}, ["robot1", "robot2"], ["dash"], ["gripper"])
    files = make_fleet(folder, members)
    assert all(file.stat().st_mode & 0o077 == 0 for file in [*files, folder / "ca-key.pem"])
    dash, gripper = folder / "dash.json5", folder / "gripper.json5"
    with (
        secure_router(folder / "hall.json5", port),
        zenoh.open(bridge_config(folder / "robot1.json5", (), is_insecure=False)) as session,
        SimulatedDaemon(f"ipc://{tmp_path}/e.ipc", ("B1",), Rates(20.0)) as daemon,
    ):
        bridge = ZenohBridge(ZenohBridgeParams(daemon.endpoint, "robot1", allow_commands=True), session)
        thread = threading.Thread(target=bridge.run)
        thread.start()
        try:
            with Subscription("zenoh:///robot1", ("slip",), keys=dash) as subscription:
                while not isinstance(item := subscription.next_item(), Message):
                    assert item is not None
            assert states("zenoh:///*", dash, 2.0)["robot1"] is not None
            with Commander("zenoh:///robot1", keys=gripper) as commander:
                assert commander.send("mark", board="B1", text="by a commander").ok
            with Commander("zenoh:///robot1", keys=dash) as commander, pytest.raises(OperatorError):
                commander.send("mark", timeout_s=0.7, board="B1", text="by a reader")
            forge(folder, gripper)
        finally:
            bridge.stop()
            thread.join()
            bridge.close()
        assert [command.arguments["text"] for command in daemon.commands] == ["by a commander"]
        with pytest.raises(zenoh.ZError):
            zenoh.open(without_certificate(folder, port))


def forge(folder: Path, reader: Path) -> None:
    """A robot publishes under the name of another, then under its own: only the latter arrives."""
    heard: list[str] = []
    came = threading.Event()

    def take(sample: "zenoh.Sample") -> None:
        heard.append(str(sample.key_expr))
        came.set()

    with (
        zenoh.open(bridge_config(reader, (), is_insecure=False)) as listening,
        zenoh.open(bridge_config(folder / "robot2.json5", (), is_insecure=False)) as robot2,
    ):
        listening.declare_subscriber("tactile/*/FORGED/*", take)
        for _ in range(50):
            robot2.put("tactile/robot1/FORGED/slip", b"")
            robot2.put("tactile/robot2/FORGED/slip", b"")
            if came.wait(0.1):
                break
    assert set(heard) == {"tactile/robot2/FORGED/slip"}


def without_certificate(folder: Path, port: int) -> "zenoh.Config":
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tls/127.0.0.1:{port}"]))
    config.insert_json5("transport/link/tls/root_ca_certificate", json.dumps(str(folder / "ca.pem")))
    return config


def test_members_are_added_and_names_are_taken_once(tmp_path: Path) -> None:
    make_fleet(tmp_path, FleetMembers({"hall": "10.0.0.1"}, ["robot1"]))
    before = (tmp_path / "robot1.json5").read_bytes()
    make_fleet(tmp_path, FleetMembers(readers=["dash"]))
    assert (tmp_path / "robot1.json5").read_bytes() == before
    assert "dash" in (tmp_path / "hall.json5").read_text()
    with pytest.raises(ConfigError, match="robot1"):
        make_fleet(tmp_path, FleetMembers(robots=["robot1"]))


def test_faults_are_reported_before_anything_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    with pytest.raises(ConfigError) as caught:
        make_fleet(folder, FleetMembers(robots=["a/b", "x", "x"]))
    assert len(caught.value.faults) == 3
    with pytest.raises(ConfigError) as caught:  # their certificates would replace keys of others
        make_fleet(folder, FleetMembers({"hall": "fe80::1"}, ["ca-key", "robot1-key"]))
    assert [fault.partition(":")[0] for fault in caught.value.faults] == [
        "'ca-key'", "'robot1-key'", "--router hall=fe80"
    ]  # fmt: skip
    assert not folder.exists()
