"""Certificates and configurations of a whole fleet, from one command: an authority, routers, robots, readers.

::

    fleet/ca.pem, ca-key.pem             the authority; keep its key away from the network
    fleet/NAME.pem, NAME-key.pem         certificate of each member, with its name as common name
    fleet/NAME.json5                     all that it carries: configuration of zenoh with certificate and key
    fleet/chosen.json                    the members, so that a second call adds to them

Routers admit members of this authority only (mutual TLS). Their access control lets a robot publish under its
own name, a reader subscribe and ask, and a commander send commands too.
"""

import base64
import json
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.outside import json_of, read_text

PORT = 7447
_DAYS = 825  # the longest that TLS libraries of all platforms accept
_NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}"
_ADDRESS = r"([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\])(?::(\d{1,5}))?"  # host and port
_CURVE = "prime256v1"


@dataclass
class FleetMembers:
    """Members of a fleet by kind; `routers` has the address of each."""

    routers: dict[str, str] = field(default_factory=dict)
    robots: list[str] = field(default_factory=list)
    readers: list[str] = field(default_factory=list)
    commanders: list[str] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """Names of all members."""
        return [*self.routers, *self.robots, *self.readers, *self.commanders]


def make_fleet(folder: Path, new: FleetMembers) -> list[Path]:
    """Add members, and write the configurations of all; return the files of the new members to carry there.

    `ConfigError` where a name is invalid or taken, or there is no router; `OperatorError` where openssl is
    not installed or fails.
    """
    known = _read(folder)
    taken = [name for name in new.names if name in known.names or new.names.count(name) > 1]
    faults = [f"{name!r}: there is a member of that name" for name in sorted(set(taken))]
    faults += [
        f"{name!r}: name a member with letters, digits, '_', '.' and '-'"
        for name in new.names
        if not re.fullmatch(_NAME, name) or name == "ca"
    ]
    # NAME-key.pem is the secret key of another member, or of the authority.
    faults += [f"{name!r}: a name must not end in '-key'" for name in new.names if name.endswith("-key")]
    faults += [
        f"--router {name}={address}: give ADDRESS or ADDRESS:PORT, and IPv6 in brackets: [fe80::1]:{PORT}"
        for name, address in new.routers.items()
        if not re.fullmatch(_ADDRESS, address)
    ]
    everyone = FleetMembers(
        known.routers | new.routers,
        known.robots + new.robots,
        known.readers + new.readers,
        known.commanders + new.commanders,
    )
    if not everyone.routers:
        faults.append("there is no router yet: give --router NAME=ADDRESS")
    if faults:
        raise ConfigError(str(folder), faults)
    if shutil.which("openssl") is None:
        raise OperatorError("keys fleet needs OpenSSL 3: sudo apt install openssl")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not (folder / "ca-key.pem").exists():
        own = ("basicConstraints=critical,CA:TRUE", "keyUsage=critical,keyCertSign,cRLSign")
        _certify(folder, "ca", "tactiled fleet", 4 * _DAYS, own)
    for name in new.names:
        _certify_member(folder, name, new.routers.get(name, ""))
    for name in everyone.names:
        config = (
            router_config(folder, name, everyone)
            if name in everyone.routers
            else _member(folder, name, everyone)
        )
        file = folder / f"{name}.json5"
        file.touch(0o600)  # it holds a secret key
        file.write_text(json.dumps(config, indent=2) + "\n")
    (folder / "chosen.json").write_text(json.dumps(asdict(everyone), indent=2) + "\n")
    return [folder / f"{name}.json5" for name in new.names]


def router_config(folder: Path, name: str, members: FleetMembers) -> dict[str, Any]:
    """Return the configuration of a router: mutual TLS, and what each member may do."""
    others = [address for other, address in members.routers.items() if other < name]
    return {
        "mode": "router",
        "scouting": {"multicast": {"enabled": False}},
        "listen": {"endpoints": [f"tls/[::]:{_host_and_port(members.routers[name])[1]}"]},
        "connect": {"endpoints": [_locator(address) for address in others]},
        "transport": {"link": {"tls": _tls(folder, name, "listen") | _tls(folder, name, "connect")}},
        "access_control": access_control(members),
    }


def access_control(members: FleetMembers) -> dict[str, Any]:
    """Return the rules of a router; the subjects are the common names of the certificates."""
    ask = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"]
    give = ["put", "delete", "reply", "declare_queryable", "liveliness_token"]
    everything = [*ask, *give]
    both = ["ingress", "egress"]
    read = ["tactile/*/*/*", "tactile/*/control"]
    rules = [
        _rule("all", everything, both, ["**"]),
        _rule("heard", give, ["egress"], ["tactile/**"]),
        _rule("read", ask, ["ingress"], read),
        _rule("boards", ["liveliness_query", "declare_liveliness_subscriber"], ["ingress"], ["tactile/*/*"]),
        # Questions to all hosts have wildcards, which no robot's own name includes.
        _rule("asked", ask, ["egress"], ["tactile/**"]),
        _rule("command", ["query"], ["ingress"], ["tactile/*/command"]),
    ]
    policies: list[dict[str, Any]] = [{"rules": ["all"], "subjects": ["routers"]}]
    subjects: list[dict[str, Any]] = [{"id": "routers", "cert_common_names": sorted(members.routers)}]
    for kind, names, granted in (
        ("readers", members.readers, ["read", "boards", "heard"]),
        ("commanders", members.commanders, ["read", "boards", "heard", "command"]),
    ):
        if names:
            subjects.append({"id": kind, "cert_common_names": names})
            policies.append({"rules": granted, "subjects": [kind]})
    for robot in members.robots:
        rules.append(_rule(f"robot-{robot}", everything, both, [f"tactile/{robot}/**"]))
        subjects.append({"id": f"robot-{robot}", "cert_common_names": [robot]})
        policies.append({"rules": ["asked", f"robot-{robot}"], "subjects": [f"robot-{robot}"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(id_: str, messages: Sequence[str], flows: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {"id": id_, "messages": messages, "flows": flows, "permission": "allow", "key_exprs": keys}


def _member(folder: Path, name: str, members: FleetMembers) -> dict[str, Any]:
    return {
        "mode": "client",
        "scouting": {"multicast": {"enabled": False}},
        "connect": {"endpoints": [_locator(address) for address in members.routers.values()]},
        "transport": {"link": {"tls": _tls(folder, name, "connect")}},
    }


def _host_and_port(address: str) -> tuple[str, str]:
    """Return host, IPv6 in brackets, and port of a router's address."""
    match = re.fullmatch(_ADDRESS, address)
    assert match is not None  # `make_fleet` refuses others
    return match[1], match[2] or str(PORT)


def _locator(address: str) -> str:
    return f"tls/{':'.join(_host_and_port(address))}"


def _tls(folder: Path, name: str, way: str) -> dict[str, Any]:
    def packed(file: str) -> str:
        return base64.b64encode((folder / file).read_bytes()).decode()

    return {
        "root_ca_certificate_base64": packed("ca.pem"),
        "enable_mtls": True,
        f"{way}_private_key_base64": packed(f"{name}-key.pem"),
        f"{way}_certificate_base64": packed(f"{name}.pem"),
    }


def _read(folder: Path) -> FleetMembers:
    file = folder / "chosen.json"
    if not file.exists():
        return FleetMembers()
    try:
        document: Any = json_of(read_text(file))
        return FleetMembers(**document)
    except (DataError, TypeError) as error:
        raise ConfigError(str(file), [f"is no file of `tactiled keys fleet`: {error}"]) from None


def _certify_member(folder: Path, name: str, address: str) -> None:
    """Make key and certificate of a member; that of a router has its address, which members verify."""
    host = _host_and_port(address)[0].strip("[]") if address else name
    is_number = re.fullmatch(r"[0-9.]+|[0-9a-fA-F:]+:[0-9a-fA-F:]*", host)
    extensions = (
        "basicConstraints=critical,CA:FALSE",
        "keyUsage=critical,digitalSignature",
        "extendedKeyUsage=serverAuth,clientAuth",
        f"subjectAltName={'IP' if is_number else 'DNS'}:{host}",
    )
    _certify(folder, name, name, _DAYS, extensions, "-CA", "ca.pem", "-CAkey", "ca-key.pem")


def _certify(
    folder: Path, name: str, common_name: str, days: int, extensions: Sequence[str], *signed_by: str
) -> None:
    """Make a key and its certificate, by default signed by the key itself."""
    (folder / f"{name}-key.pem").touch(0o600)
    words = [word for extension in extensions for word in ("-addext", extension)]
    command = [
        "openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", f"ec_paramgen_curve:{_CURVE}", "-nodes",
        "-keyout", f"{name}-key.pem", "-out", f"{name}.pem", "-subj", f"/CN={common_name}", "-sha256",
        "-days", str(days), *words, *signed_by,
    ]  # fmt: skip
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OperatorError(f"openssl req: {done.stderr.strip()[-300:]}")
