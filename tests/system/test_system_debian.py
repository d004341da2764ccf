"""The Debian package in a bare Debian: installed without network, runs a board, upgraded, purged clean."""

import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from nspawn import COMMAND_S, NEW, OLD, Container, ContainerError, copy_root, make_package, wait_until

from tactiled.client import Message, Subscription

pytestmark = pytest.mark.system
SERIAL = "TS0001"
PACKAGES = "/wheels/packages"


@pytest.fixture(scope="module")
def container(
    bare_debian: Path, wheels: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Container]:
    """A booted Debian that has never heard of tactiled, and both packages in it."""
    folder = tmp_path_factory.mktemp("deb")
    root = folder / "root"
    try:
        for version in (OLD, NEW):
            make_package(wheels, version)
        copy_root(bare_debian, root)
        with Container(root, wheels) as booted:
            yield booted
    except ContainerError as reason:
        pytest.skip(f"not tested in a container: {reason}")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def found(container: Container) -> set[str]:
    """All that is named after tactiled in the container, but what dpkg remembers."""
    apart = ("-path", "/wheels", "-prune", "-o", "-path", "/var/lib/dpkg", "-prune", "-o")
    return set(container.run("find", "/", "-xdev", *apart, "-name", "*tactiled*", "-print").split())


def test_the_package_from_installation_to_purge(container: Container) -> None:
    before = found(container)
    container.run("sh", "-c", f"dpkg -i {PACKAGES}/tactiled_{OLD}_*.deb")
    assert container.run("tactiled", "--version").splitlines()[0] == f"tactiled, version {OLD}"
    assert container.run("id", "-gn", "tactiled").strip() == "tactiled"
    assert (container.root / "usr/lib/udev/rules.d/99-tactiled.rules").exists()
    assert container.run("dpkg", "--verify", "tactiled") == ""
    # As docs/service.md says: the example becomes the configuration of a board.
    example = (container.root / "etc/tactiled/tactiled.toml.example").read_text()
    assert "[port]" in example
    (container.root / f"etc/tactiled/{SERIAL}.toml").write_text(
        f'[port]\nurl = "/dev/tactiled-{SERIAL}"\n'
        '[publish]\nendpoints = ["ipc://{runtime}/events.ipc"]\n'
        f'[session]\nboard_serial = "{SERIAL}"\n'
    )
    (container.root / "etc/board.toml").write_text(f'board_serial = "{SERIAL}"\n')
    container.run(
        "systemd-run", "--quiet", "--unit=board", "--property=StandardOutput=file:/var/tmp/board.jsonl",
        "tactiled", "emulate", "--scene", "rest", "--board", "/etc/board.toml",
        "--link", f"/dev/tactiled-{SERIAL}",
    )  # fmt: skip
    told = container.root / "var/tmp/board.jsonl"
    wait_until(lambda: told.exists() and "ready" in told.read_text(), "the board is there")
    device = json.loads(told.read_text().splitlines()[0])["device"]
    container.run("chgrp", "dialout", device)
    container.run("chmod", "0660", device)
    unit = f"tactiled@{SERIAL}.service"
    container.run("systemctl", "start", unit)
    message_of(container, "scan")

    container.run("sh", "-c", f"dpkg -i {PACKAGES}/tactiled_{NEW}_*.deb")
    assert container.run("tactiled", "--version").splitlines()[0] == f"tactiled, version {NEW}"
    assert container.shown(unit, "ActiveState") == ["active"]
    assert message_of(container, "info").data["tactiled_version"] == NEW  # restarted by the upgrade

    container.run("dpkg", "--remove", "tactiled")
    assert container.shown(unit, "ActiveState", "LoadState") == ["inactive", "not-found"]
    assert (container.root / f"etc/tactiled/{SERIAL}.toml").exists()  # until purged
    container.run("dpkg", "--purge", "tactiled")
    container.run("systemctl", "stop", "board")
    assert found(container) == before


def message_of(container: Container, topic: str) -> Message:
    """The next message of a topic."""
    until_s = time.monotonic() + COMMAND_S
    with Subscription(f"ipc://{container.seen(f'/run/tactiled/{SERIAL}/events.ipc')}") as messages:
        while (item := messages.next_item(until_s)) is not None:
            if isinstance(item, Message) and item.topic == topic:
                return item
    raise AssertionError(f"no message of topic {topic} within {COMMAND_S:.0f} s")
