"""Keys and tokens in files: nobody else may be able to read them."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tactiled.cli import main
from tactiled.errors import ConfigError, DataError
from tactiled.outside import SECRET_LIMIT_BYTES, read_secret

TOKEN = "0123456789abcdef"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "secret"
    path.write_text(TOKEN)
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_a_secret_of_its_owner_is_read(file: Path, mode: int) -> None:
    file.chmod(mode)
    assert read_secret(file) == TOKEN


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o644])
def test_a_secret_that_others_can_read_or_change_is_refused(file: Path, mode: int) -> None:
    file.chmod(mode)
    with pytest.raises(ConfigError, match=f"secret: others can read the token: chmod 600 {file}"):
        read_secret(file, "token")


def test_a_credential_of_the_service_manager_may_have_any_mode(file: Path) -> None:
    file.chmod(0o440)
    assert read_secret(file, environ={"CREDENTIALS_DIRECTORY": str(file.parent)}) == TOKEN
    for elsewhere in ("", str(file.parent.parent)):
        with pytest.raises(ConfigError, match="others can read"):
            read_secret(file, environ={"CREDENTIALS_DIRECTORY": elsewhere})


def test_what_is_no_small_file_is_refused(file: Path, tmp_path: Path) -> None:
    file.write_bytes(b"x" * (SECRET_LIMIT_BYTES + 1))
    with pytest.raises(DataError, match="more than 65536 bytes"):
        read_secret(file)
    os.mkfifo(tmp_path / "fifo", 0o600)
    with pytest.raises(DataError, match="not a regular file"):
        read_secret(tmp_path / "fifo")


@pytest.fixture
def web(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[[Path | None], str]:
    def run(token_file: Path | None) -> str:
        """Return what `tactiled web` says when it refuses a token."""
        asked = ["web", "--events", "ipc:///x/e.ipc", "--allow-commands"]
        asked += [] if token_file is None else ["--token-file", str(token_file)]
        monkeypatch.setattr(sys, "argv", ["tactiled", *asked])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        return capsys.readouterr().err

    return run


@pytest.mark.parametrize(
    ("mode", "text", "words"),
    [
        (0o644, TOKEN, "others can read the token: chmod 600"),
        (0o600, "short", "at least 16 characters"),
        (0o600, "é" * 16, "at least 16 characters"),
        (0o600, "S3cr3t-100%-Sure-Tok", "only letters, digits and"),
        (0o600, "abc&defghijklmnopqrs", "only letters, digits and"),
    ],
)
def test_the_page_refuses_a_bad_token_file(
    file: Path, mode: int, text: str, words: str, web: Callable[[Path | None], str]
) -> None:
    file.write_text(text)
    file.chmod(mode)
    assert words in web(file)


def test_the_page_says_that_its_token_file_is_not_there(
    tmp_path: Path, web: Callable[[Path | None], str]
) -> None:
    assert "cannot be read: No such file" in web(tmp_path / "none")


def test_a_short_token_of_the_environment_is_refused(
    monkeypatch: pytest.MonkeyPatch, web: Callable[[Path | None], str]
) -> None:
    monkeypatch.setenv("TACTILED_WEB_TOKEN", "short")
    assert "$TACTILED_WEB_TOKEN: a token has at least 16 characters" in web(None)
