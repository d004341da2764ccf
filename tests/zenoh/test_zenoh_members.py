"""Configurations of a fleet: who connects where, with which certificate, and what each may do."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tactiled.errors import ConfigError
from tactiled.zenoh.certificates import FleetMembers, access_control, make_fleet

MEMBERS = FleetMembers(
    {"hall": "10.0.0.1", "lab": "[fe80::1]:7000", "yard": "yard.example:7448"},
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
            "tls/10.0.0.1:7447", "tls/[fe80::1]:7000", "tls/yard.example:7448"
        ]  # fmt: skip
        assert "listen" not in found
        assert "access_control" not in found


def test_each_pair_of_routers_has_one_connection(folder: Path) -> None:
    routers = {name: config(folder, name) for name in MEMBERS.routers}
    assert {name: found["connect"]["endpoints"] for name, found in routers.items()} == {
        "hall": [],
        "lab": ["tls/10.0.0.1:7447"],
        "yard": ["tls/10.0.0.1:7447", "tls/[fe80::1]:7000"],
    }
    for found in routers.values():
        assert found["mode"] == "router"
        assert found["scouting"] == {"multicast": {"enabled": False}}
        assert found["listen"]["endpoints"] == ["tls/[::]:7447"]
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
    assert keys == {"tactile/r1/**", "tactile/r1/**/@adv/**"}
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
