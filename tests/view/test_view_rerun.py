"""A recording for rerun, opened by rerun's own program."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="needs pip install 'tactiled[rerun]'")

from messages import CONTACT, SLIP

from tactiled.events.types import ForceEvent, GripEvent, ScanEvent, TextureEvent
from tactiled.recording.contents import Header, load_board
from tactiled.recording.writer import RecordingWriter

UNIX_S = 1_700_000_000.0


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "slide.mcap"
    with RecordingWriter(path, Header(load_board("board-v1", "wang2019-3x3"))) as writer:
        for n in range(20):
            volts = tuple(0.1 * n + 0.01 * channel for channel in range(36))
            scan = ScanEvent(
                time_s=0.01 * n,
                index=n,
                volts=volts,
                valid=(True,) * 36,
                time_sd_s=0.0,
                age_s=0.0,
                late=False,
            )
            grip = GripEvent(time_s=0.01 * n, state="sticking", utilisation=0.5, valid=True)
            force = ForceEvent(time_s=0.01 * n, fz_n=1.0, calibration="mine", valid=True)
            for event in (scan, grip, force):
                writer.event(event, "TS0001", UNIX_S, "pipeline")
        texture = TextureEvent(time_s=0.2, status="low-snr", answered_s=0.2)
        for last in (CONTACT, SLIP, texture):
            writer.event(last, "TS0001", UNIX_S, "pipeline")
    return path


def test_the_saved_file_is_valid_and_has_every_entity_and_the_blueprint(
    recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "slide.rrd"
    command = [sys.executable, "-m", "tactiled", "view", "--rerun", str(recording), "--save", str(out)]
    subprocess.run(command, check=True, timeout=120)

    def rerun(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "rerun", "rrd", *arguments, str(out)],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    rerun("verify")
    printed = rerun("print", "-vv")
    for entity in (
        "/skin/load",
        "/skin/shear",
        "/sums/load",
        "/friction/utilisation",
        "/force/fz_n",
        "/events",
    ):
        assert entity in printed, entity
    assert "blueprint" in printed.lower()
