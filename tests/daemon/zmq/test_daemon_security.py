"""Keys: made, listed, let in, shut out; and nothing that other hosts can reach without them."""

import asyncio
import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import given, settings
from hypothesis import strategies as st
from networks import NetworkAlone
from patience import PATIENCE_S
from ports import free_pair

from tactiled import tomlfile
from tactiled.client import AsyncCommander, Client, Message
from tactiled.daemon.zmq.network import Network
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.security import CurveAuthenticator, KeyFolder
from tactiled.errors import ConfigError, OperatorError


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    keys = KeyFolder(tmp_path / "keys")
    keys.make("left", tmp_path / "left.toml")
    return keys


def test_making_a_client_makes_the_daemon_too_and_secrets_stay_secret(
    folder: KeyFolder, tmp_path: Path
) -> None:
    public, secret = folder.pair()
    assert len(public) == len(secret) == 40
    assert zmq.curve_public(secret) == public
    assert list(folder.clients().values()) == ["left"]
    for path, mode in (("keys/daemon.toml", 0o600), ("left.toml", 0o600), ("keys/clients/left.toml", 0o644)):
        assert stat.S_IMODE((tmp_path / path).stat().st_mode) == mode
    assert "secret" not in (tmp_path / "keys/clients/left.toml").read_text()
    assert secret.decode() not in (tmp_path / "left.toml").read_text()
    folder.make("right", tmp_path / "right.toml")
    assert folder.pair() == (public, secret)
    assert sorted(folder.clients().values()) == ["left", "right"]


def test_the_pair_may_come_from_the_service_manager(folder: KeyFolder, tmp_path: Path) -> None:
    pair = folder.pair()
    credentials = tmp_path / "credentials"
    credentials.mkdir()
    (folder.path / "daemon.toml").rename(credentials / "daemon.toml")
    assert folder.pair({"CREDENTIALS_DIRECTORY": str(credentials)}) == pair
    with pytest.raises(ConfigError, match="cannot be read"):
        folder.pair({"CREDENTIALS_DIRECTORY": str(tmp_path)})


@pytest.mark.parametrize("name", ["", "a/b", "../x", ".hidden", "daemon", "a b", "x" * 64, "é"])
def test_an_invalid_client_name_is_refused(folder: KeyFolder, tmp_path: Path, name: str) -> None:
    with pytest.raises(OperatorError, match="letters, digits"):
        folder.make(name, tmp_path / "out.toml")


def test_no_key_is_overwritten_or_half_written(folder: KeyFolder, tmp_path: Path) -> None:
    before = (tmp_path / "left.toml").read_text()
    with pytest.raises(OperatorError, match=r"left\.toml: exists"):
        folder.make("left", tmp_path / "left.toml")
    with pytest.raises(OperatorError, match=r"clients/left\.toml: exists"):
        folder.make("left", tmp_path / "other.toml")
    assert not (tmp_path / "other.toml").exists()
    assert (tmp_path / "left.toml").read_text() == before
    with pytest.raises(OperatorError, match="cannot be written"):
        folder.make("new", tmp_path / "no" / "such" / "folder.toml")
    assert "new" not in folder.clients().values()


def test_a_full_disk_leaves_no_empty_key_file(
    folder: KeyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, *_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as disk:
        disk.setattr(Path, "write_text", full)
        with pytest.raises(OperatorError, match="No space left on device"):
            folder.make("right", tmp_path / "right.toml")
    folder.make("right", tmp_path / "right.toml")
    assert list(folder.clients().values()) == ["left", "right"]


def test_a_daemon_without_a_good_pair_does_not_start(folder: KeyFolder, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="tactiled keys make"):
        KeyFolder(tmp_path / "none").pair()
    path = folder.path / "daemon.toml"
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="others can read the secret key: chmod 600"):
        folder.pair()
    path.rename(
        tmp_path / "daemon.toml"
    )  # systemd's LoadCredential= shows its access list as group permissions
    folder.pair({"CREDENTIALS_DIRECTORY": str(tmp_path)})
    (tmp_path / "daemon.toml").rename(path)
    path.chmod(0o600)
    path.write_text('public_key = "short"\n')
    with pytest.raises(ConfigError, match="secret_key: missing"):
        folder.pair()


def test_an_invalid_client_file_excludes_only_that_client(
    folder: KeyFolder, caplog: pytest.LogCaptureFixture
) -> None:
    (folder.path / "clients" / "bad.toml").write_text("public_key = 7\n")
    (folder.path / "clients" / "worse.toml").write_bytes(b"\xff\xfe")
    assert list(folder.clients().values()) == ["left"]
    assert "bad.toml: public_key" in caplog.text
    assert "worse.toml" in caplog.text


def test_a_removed_client_is_excluded_without_a_restart(folder: KeyFolder) -> None:
    assert folder.clients()
    (folder.path / "clients" / "left.toml").unlink()
    assert folder.clients() == {}


@contextmanager
def authenticator(folder: KeyFolder) -> Iterator[CurveAuthenticator]:
    with zmq.Context() as context:
        opened = CurveAuthenticator(context, folder)
        yield opened
        opened.close()


@given(request=st.lists(st.binary(max_size=40), max_size=9))
@settings(deadline=None)
def test_invalid_authentication_requests_are_denied(
    tmp_path_factory: pytest.TempPathFactory, request: list[bytes]
) -> None:
    path = tmp_path_factory.mktemp("keys")
    keys = KeyFolder(path / "keys")
    keys.make("left", path / "left.toml")
    with authenticator(keys) as opened:
        reply = opened.answer(request, 0.0)
        assert len(reply) == 6
        assert reply[2] == b"400"
        assert opened.denied.count == 1


def test_another_domain_or_mechanism_is_denied_even_with_the_key(folder: KeyFolder) -> None:
    (key,) = folder.clients()
    raw = zmq.utils.z85.decode(key)
    with authenticator(folder) as opened:
        good = [b"1.0", b"7", b"tactiled", b"10.0.0.2", b"", b"CURVE", raw]
        assert opened.answer(good, 0.0) == [b"1.0", b"7", b"200", b"OK", b"left", b""]
        for place, other in (
            (0, b"2.0"),
            (2, b""),
            (2, b"other"),
            (5, b"PLAIN"),
            (5, b"NULL"),
            (6, raw[:31]),
        ):
            assert opened.answer([*good[:place], other, *good[place + 1 :]], 0.0)[2] == b"400"


class Server(NetworkAlone):
    """A network whose loopback endpoint counts as one that other hosts can reach."""

    def __init__(self, tmp_path: Path, port: int, folder: KeyFolder) -> None:
        self.wide = f"tcp://127.0.0.1:{port}"
        self.local = f"ipc://{tmp_path}/events.ipc"
        super().__init__(endpoints=(self.wide, self.local), keys=str(folder.path))

    @property
    def keys_used(self) -> list[str]:
        return [requester.key for requester in self.requesters]

    async def hears(self, endpoint: str, keys: Path | None, patience_s: float) -> bool:
        """Return True when a client receives published messages."""
        async with Client(endpoint, topics=("contact",), control="", keys=keys) as client:
            try:
                async with asyncio.timeout(patience_s):
                    while True:
                        self.send()
                        try:
                            async with asyncio.timeout(0.02):
                                if isinstance(await anext(client), Message):
                                    return True
                        except TimeoutError:
                            continue
            except TimeoutError:
                return False


@pytest.fixture
def server(tmp_path: Path, folder: KeyFolder, monkeypatch: pytest.MonkeyPatch) -> Server:
    def is_guarded(params: PublishParams, endpoint: str) -> bool:
        return params.keys is not None and endpoint.startswith("tcp://")

    monkeypatch.setattr(PublishParams, "is_guarded", is_guarded)
    return Server(tmp_path, free_pair(), folder)


def test_a_client_with_a_key_receives_and_commands_under_its_name(server: Server, tmp_path: Path) -> None:
    async def story() -> None:
        keys = tmp_path / "left.toml"
        assert await server.hears(server.wide, keys, PATIENCE_S)
        async with AsyncCommander(server.wide, keys=keys) as daemon:
            assert (await daemon.send("mark", text="hello")).ok
        assert server.keys_used == ["left"]

    server.run(story, 3 * PATIENCE_S)


def test_a_client_without_a_valid_key_receives_nothing_and_is_logged(
    server: Server, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    stranger = KeyFolder(tmp_path / "elsewhere")
    stranger.make("left", tmp_path / "stranger.toml")
    daemon_key = next(
        line for line in (tmp_path / "left.toml").read_text().splitlines() if line.startswith("daemon_key")
    )
    forged = tmp_path / "forged.toml"  # a pair of his own, and the true daemon's public key
    lines = (tmp_path / "stranger.toml").read_text().splitlines()[:2]
    forged.write_text("\n".join([*lines, daemon_key]))
    forged.chmod(0o600)

    async def story() -> None:
        async with asyncio.timeout(PATIENCE_S):
            while "client denied: 127.0.0.1" not in caplog.text:  # it may need more time to be denied
                assert not await server.hears(server.wide, forged, 0.5)
        assert not await server.hears(server.wide, tmp_path / "stranger.toml", 0.3)  # trusts another daemon
        assert not await server.hears(server.wide, None, 0.3)
        async with AsyncCommander(server.wide, keys=forged) as daemon:
            with pytest.raises(OperatorError, match="no answer"):
                await daemon.send("mark", timeout_s=0.3, text="x")
        assert server.keys_used == []
        assert await server.hears(server.wide, tmp_path / "left.toml", PATIENCE_S)

    server.run(story, 3 * PATIENCE_S)


def test_local_endpoints_need_no_key(server: Server) -> None:
    async def story() -> None:
        assert await server.hears(server.local, None, PATIENCE_S)
        async with AsyncCommander(server.local) as daemon:
            assert (await daemon.send("mark", text="x")).ok
        assert server.keys_used == [""]

    server.run(story, 3 * PATIENCE_S)


def test_a_forged_daemon_is_rejected(server: Server, tmp_path: Path) -> None:
    """It answers at the daemon's address and lets the client in, but lacks the key that the client knows."""
    text = (tmp_path / "left.toml").read_text()
    true_daemon = zmq.curve_keypair()[0].decode()
    keys = tmp_path / "of-the-true-daemon.toml"
    keys.write_text(text[: text.index("daemon_key")] + f'daemon_key = "{true_daemon}"\n')
    keys.chmod(0o600)

    async def story() -> None:
        assert not await server.hears(server.wide, keys, 0.5)
        async with AsyncCommander(server.wide, keys=keys) as daemon:
            with pytest.raises(OperatorError, match="no answer"):
                await daemon.send("mark", timeout_s=0.3, text="x")
        assert server.keys_used == []
        assert await server.hears(server.wide, tmp_path / "left.toml", PATIENCE_S)

    server.run(story, 3 * PATIENCE_S)


def test_network_endpoints_need_keys_or_an_explicit_option(tmp_path: Path) -> None:
    def parse(**extra: Any) -> PublishParams:
        return tomlfile.parse({"endpoints": ["tcp://0.0.0.0:9872"], **extra}, PublishParams, "t.toml")

    with pytest.raises(ConfigError, match="tactiled keys make"):
        parse()
    assert parse(keys="/etc/tactiled/keys").control == ("tcp://0.0.0.0:9873",)
    with pytest.raises(ConfigError, match=r"daemon\.toml: cannot be read"):
        Network(parse(keys=str(tmp_path)), [])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no file of `tactiled keys make`"),
        ('public_key = "a"', "no file of"),
        ("public_key = [", "no file of"),
        ('public_key = "a"\nsecret_key = "b"\ndaemon_key = "c"', "40 characters"),
        ('public_key = "é"\nsecret_key = "b"\ndaemon_key = "c"', "no file of"),
    ],
)
def test_a_bad_client_file_is_a_clear_error(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "k.toml"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=says):
        asyncio.run(_enter(path))
    with pytest.raises(ConfigError, match="cannot be read"):
        asyncio.run(_enter(tmp_path / "none.toml"))


def test_a_secret_key_that_others_can_read_is_an_error(folder: KeyFolder, tmp_path: Path) -> None:
    path = tmp_path / "right.toml"
    folder.make("right", path)
    asyncio.run(_enter(path))
    for mode in (0o644, 0o640, 0o602):
        path.chmod(mode)
        with pytest.raises(ConfigError, match=r"others can read the secret key: chmod 600 .*right\.toml"):
            asyncio.run(_enter(path))


async def _enter(keys: Path) -> None:
    async with Client(f"ipc://{os.devnull}.ipc", keys=keys):
        pass
