"""Playback on a pseudo-terminal: to any driver, a recording behaves as a board: same bytes, same timing."""

import os
import threading
import time
import tty
from pathlib import Path

import pytest
from patience import PATIENCE_S
from recordings import record, simulated_reads

from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.recording.contents import Read
from tactiled.recording.playback import PlaybackResult, play


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Read]]:
    path = tmp_path_factory.mktemp("recording") / "a.mcap"
    reads = simulated_reads(1.0)
    record(path, reads)
    return path, reads


class Driver(threading.Thread):
    """Somebody else's driver: opens the port, talks to it, reads so many bytes."""

    def __init__(self, link: Path, n_bytes: int) -> None:
        super().__init__(daemon=True)
        self.link, self.n_bytes = link, n_bytes
        self.data = b""

    def run(self) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while not self.link.is_symlink() and time.monotonic() < until_s:
            time.sleep(0.005)
        port = os.open(self.link, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(port)
        os.write(port, b"hello board")
        while len(self.data) < self.n_bytes and time.monotonic() < until_s:
            self.data += os.read(port, 4096)
        os.close(port)


def played_to(driver: Driver, path: Path, speed: float) -> PlaybackResult:
    driver.start()
    try:
        return play([path], driver.link, speed)
    finally:
        driver.join(PATIENCE_S)


def test_a_driver_gets_every_byte(tmp_path: Path, recording: tuple[Path, list[Read]]) -> None:
    path, reads = recording
    whole = b"".join(read.data for read in reads)
    driver = Driver(tmp_path / "port", len(whole))
    played = played_to(driver, path, 0.0)
    assert driver.data == whole
    assert played.n_bytes == len(whole)
    assert not (tmp_path / "port").is_symlink()


def test_playback_takes_as_long_as_the_recording(tmp_path: Path, recording: tuple[Path, list[Read]]) -> None:
    path, reads = recording
    whole = b"".join(read.data for read in reads)
    driver = Driver(tmp_path / "port", len(whole))
    began_s = time.monotonic()
    played_to(driver, path, 2.0)
    # Never faster than recorded; slower is the machine's affair.
    assert time.monotonic() - began_s >= (reads[-1].arrival_s - reads[0].arrival_s) / 2
    assert driver.data == whole


def test_playback_ends_when_the_driver_leaves(tmp_path: Path, recording: tuple[Path, list[Read]]) -> None:
    path, _ = recording
    with pytest.raises(OperatorError, match=r"closed the port after \d+ bytes"):
        played_to(Driver(tmp_path / "port", 100), path, 1.0)
    assert not (tmp_path / "port").is_symlink()


def test_an_unplayable_file_gives_a_reason(tmp_path: Path, recording: tuple[Path, list[Read]]) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(ConfigError, match=r"cannot make .*taken: File exists"):
        play([recording[0]], tmp_path / "taken")
    with pytest.raises(DataError, match="No such file"):
        play([tmp_path / "none.mcap"], tmp_path / "port")
