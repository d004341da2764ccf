"""Logs: priorities for the journal, plain lines for people."""

import io
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from tactiled.daemon.operations import log


@pytest.fixture(autouse=True)
def logger_as_before() -> Iterator[None]:
    logger = logging.getLogger("tactiled")
    before = logger.handlers, logger.level
    yield
    logger.handlers, level = before
    logger.setLevel(level)


def written(path: Path, monkeypatch: pytest.MonkeyPatch, journal: bool) -> list[str]:
    with path.open("w+") as stream:
        stat = path.stat()
        inode = stat.st_ino if journal else stat.st_ino + 1
        monkeypatch.setenv("JOURNAL_STREAM", f"{stat.st_dev}:{inode}")
        log.set_up(logging.DEBUG, stream)
        logger = logging.getLogger("tactiled.daemon.test")
        logger.debug("d")
        logger.info("i")
        logger.warning("w")
        try:
            raise ValueError("two\nlines")  # noqa: TRY301  a traceback is wanted
        except ValueError:
            logger.exception("e")
    return path.read_text().splitlines()


def test_each_line_has_its_priority_for_the_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = written(tmp_path / "log", monkeypatch, journal=True)
    assert lines[:4] == ["<7>d", "<6>i", "<4>w", "<3>e"]
    assert len(lines) > 6
    assert all(line.startswith("<3>") for line in lines[3:])


def test_a_terminal_gets_no_priorities(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = written(tmp_path / "log", monkeypatch, journal=False)
    assert lines[1].endswith("INFO i")
    assert not any(line.startswith("<") for line in lines)


def test_a_stream_without_descriptor_is_no_journal() -> None:
    assert not log.journal_listens(io.StringIO(), {"JOURNAL_STREAM": "1:2"})
