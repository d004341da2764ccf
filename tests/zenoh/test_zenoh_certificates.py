"""Certificates and configurations of a fleet: what each member may do, in its files and at a real router."""

import json
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest
import zenoh
from routers import free_port
from simulated_daemon import Rates, SimulatedDaemon
from zenoh_threads import zenoh_threads

from tactiled.client import Commander, Message, Subscription
from tactiled.errors import ConfigError, OperatorError
from tactiled.zenoh.bridge import ZenohBridge, ZenohBridgeParams
from tactiled.zenoh.certificates import FleetMembers, access_control, make_fleet
from tactiled.zenoh.safety import bridge_config
from tactiled.zenoh.session import states

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
            assert states("zenoh:///*", dash, 2.0)["robot1"][0] is not None
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


MEMBERS = FleetMembers(
    {"hall": "10.0.0.1", "lab": "[fe80::1]:7000", "six": "[fe80::2]", "yard": "yard.example:7448"},
    ["r1", "r2"],
    ["dash"],
    ["gripper"],
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys") / "fleet"
    files = make_fleet(folder, MEMBERS)
    assert files == [folder / f"{name}.json5" for name in MEMBERS.names]
    return folder


def config(folder: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / f"{name}.json5").read_text())
    return content


def openssl(folder: Path, *words: str) -> str:
    return subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True, text=True).stdout


def test_every_member_is_a_client_of_all_routers(folder: Path) -> None:
    for name in ("r1", "dash", "gripper"):
        found = config(folder, name)
        assert found["mode"] == "client"
        assert found["scouting"] == {"multicast": {"enabled": False}}
        assert found["connect"]["endpoints"] == [
            "tls/10.0.0.1:7447", "tls/[fe80::1]:7000", "tls/[fe80::2]:7447", "tls/yard.example:7448"
        ]  # fmt: skip
        assert "listen" not in found
        assert "access_control" not in found


def test_each_pair_of_routers_has_one_connection(folder: Path) -> None:
    routers = {name: config(folder, name) for name in MEMBERS.routers}
    assert {name: found["connect"]["endpoints"] for name, found in routers.items()} == {
        "hall": [],
        "lab": ["tls/10.0.0.1:7447"],
        "six": ["tls/10.0.0.1:7447", "tls/[fe80::1]:7000"],
        "yard": ["tls/10.0.0.1:7447", "tls/[fe80::1]:7000", "tls/[fe80::2]:7447"],
    }
    assert {name: found["listen"]["endpoints"] for name, found in routers.items()} == {
        "hall": ["tls/[::]:7447"],
        "lab": ["tls/[::]:7000"],
        "six": ["tls/[::]:7447"],
        "yard": ["tls/[::]:7448"],
    }
    for found in routers.values():
        assert found["mode"] == "router"
        assert found["scouting"] == {"multicast": {"enabled": False}}
        assert found["access_control"] == access_control(MEMBERS)


def test_certificates_are_of_this_authority_for_825_days(folder: Path) -> None:
    for name in MEMBERS.names:
        assert openssl(folder, "verify", "-CAfile", "ca.pem", f"{name}.pem").endswith("OK\n")
        text = openssl(folder, "x509", "-in", f"{name}.pem", "-noout", "-text")
        assert f"CN = {name}" in text or f"CN={name}" in text
        assert "CA:FALSE" in text
        assert "TLS Web Server Authentication, TLS Web Client Authentication" in text
        assert "prime256v1" in text
        day = 86_400
        subprocess.run(
            ["openssl", "x509", "-in", f"{name}.pem", "-checkend", str(824 * day)], cwd=folder, check=True
        )
        late = subprocess.run(
            ["openssl", "x509", "-in", f"{name}.pem", "-checkend", str(826 * day)], cwd=folder, check=False
        )
        assert late.returncode == 1
    assert "CA:TRUE" in openssl(folder, "x509", "-in", "ca.pem", "-noout", "-text")


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("hall", "IP Address:10.0.0.1"),
        ("lab", "IP Address:FE80:0:0:0:0:0:0:1"),
        ("six", "IP Address:FE80:0:0:0:0:0:0:2"),
        ("yard", "DNS:yard.example"),
        ("dash", "DNS:dash"),
    ],
)
def test_a_certificate_names_the_address_that_others_verify(folder: Path, name: str, place: str) -> None:
    assert place in openssl(folder, "x509", "-in", f"{name}.pem", "-noout", "-ext", "subjectAltName")


def test_secrets_are_readable_by_their_owner_alone_and_nothing_else_is_left(folder: Path) -> None:
    assert folder.stat().st_mode & 0o777 == 0o700
    for file in folder.iterdir():
        if file.name.endswith("-key.pem") or file.suffix == ".json5":
            assert file.stat().st_mode & 0o777 == 0o600, file
    assert {file.suffix for file in folder.iterdir()} <= {".pem", ".json5", ".json", ".srl"}


def rules_of(member: str) -> dict[str, tuple[set[str], set[str], set[str]]]:
    """Rules that hold for a member, by name: messages, directions, keys."""
    control = access_control(MEMBERS)
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    rules = {rule["id"]: rule for rule in control["rules"]}
    assert {rule["permission"] for rule in rules.values()} == {"allow"}
    subjects = {one["id"] for one in control["subjects"] if member in one["cert_common_names"]}
    ids = [
        id_ for policy in control["policies"] if subjects & set(policy["subjects"]) for id_ in policy["rules"]
    ]
    return {
        id_: (set(rules[id_]["messages"]), set(rules[id_]["flows"]), set(rules[id_]["key_exprs"]))
        for id_ in ids
    }


def test_a_robot_publishes_under_its_own_name_only() -> None:
    found = rules_of("r1")
    assert found.keys() == {"asked", "robot-r1"}
    messages, flows, keys = found["robot-r1"]
    assert {"put", "reply", "declare_queryable", "liveliness_token"} <= messages
    assert flows == {"ingress", "egress"}
    assert keys == {"tactile/r1/**"}
    assert found["asked"][1] == {"egress"}  # from the router to the robot: it asks nobody
    assert "put" not in found["asked"][0]


@pytest.mark.parametrize(("member", "may_command"), [("dash", False), ("gripper", True)])
def test_only_commanders_send_commands_and_no_reader_publishes(member: str, *, may_command: bool) -> None:
    found = rules_of(member)
    assert ("command" in found) is may_command
    sends = [(messages, keys) for messages, flows, keys in found.values() if "ingress" in flows]
    assert not any(messages & {"put", "delete", "reply", "declare_queryable"} for messages, _ in sends)
    assert any("tactile/*/command" in keys for _, keys in sends) is may_command


@pytest.mark.parametrize(
    ("new", "said"),
    [
        (FleetMembers(robots=["r9"]), "no router yet"),
        (FleetMembers({"hall": "h"}, ["ca"]), "name a member"),
        (FleetMembers({"hall": "h"}, ["-r"]), "name a member"),
        (FleetMembers({"hall": "h"}, ["r" * 64]), "name a member"),
        (FleetMembers({"hall": "h"}, ["hall"]), "a member of that name"),
        (FleetMembers({"hall": "h:"}), "give ADDRESS"),
        (FleetMembers({"hall": "h:123456"}), "give ADDRESS"),
        (FleetMembers({"hall": "h/../x"}), "give ADDRESS"),
    ],
)
def test_members_that_cannot_be_are_refused(new: FleetMembers, said: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=said):
        make_fleet(tmp_path / "fleet", new)
    assert not (tmp_path / "fleet").exists()


@pytest.mark.parametrize("content", ["[", "[1]", '{"surplus": 1}'])
def test_a_list_of_members_that_is_none_is_named(content: str, tmp_path: Path) -> None:
    (tmp_path / "chosen.json").write_text(content)
    with pytest.raises(ConfigError, match=r"chosen\.json: is no file of `tactiled keys fleet`"):
        make_fleet(tmp_path, FleetMembers({"hall": "h"}))
