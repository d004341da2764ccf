"""The guide asks for what is lacking and is content with presses; what is recorded can be fitted."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.calibrate import guide
from tactiled.calibrate.guide import GOOD, Guide, GuidedLog
from tactiled.client.items import Message
from tactiled.client.subscriber import Subscription
from tactiled.emulator.rig.motion import Motion
from tactiled.emulator.rig.session import draw_rig
from tactiled.errors import ConfigError, DataError
from tactiled.scan_log import LiveScans, read_log

ARRAY = load_array("wang2019-3x3")


def runs(*motions: Motion, seconds: float = 60.0) -> np.ndarray:
    """Readings of a person who presses a rig."""
    rig, rng = draw_rig(ARRAY, 2)
    return np.concatenate([rig.run(motion, seconds, rng).readings for motion in motions])


def guided(readings: np.ndarray) -> Guide:
    made = Guide(ARRAY)
    for start in range(0, len(readings), 100):
        made.add(readings[start : start + 100])
    return made


def test_flat_presses_ask_for_shear_or_single_taxels() -> None:
    advice = guided(runs("flat")).advice()
    assert "sideways" in advice.motion or "finger tip" in advice.motion
    assert min(advice.sd["shear x"], advice.sd["shear y"]) > GOOD


@pytest.mark.parametrize("taxel", [0, 8])
def test_a_taxel_that_was_left_out_is_named(taxel: int) -> None:
    readings = runs("walk", "tip")
    readings[:, 4 * taxel : 4 * taxel + 4] = 0.0
    assert f"taxel {taxel} at" in guided(readings).advice().motion


def test_missing_readings_are_no_press() -> None:
    raised = replace(ARRAY, zero=np.full(ARRAY.n_channels, 2.5))
    readings = 2.5 + 1e-3 * np.random.default_rng(0).standard_normal((200, ARRAY.n_channels))
    readings[120:130] = np.nan
    made = Guide(raised)
    made.add(readings[:100])
    made.add(readings[100:])
    assert min(made.advice().sd.values()) > 0.4


class PlayedSubscription:
    """Subscription to a daemon whose board plays readings; a second of scans at each look.

    After 20 scans, the clock of its host is set back by `set_back_s`.
    """

    def __init__(self, readings: np.ndarray, set_back_s: float = 0.0) -> None:
        self._items = self._played(readings, set_back_s)

    def __enter__(self) -> "PlayedSubscription":
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def next_item(self, _until_s: float) -> Message | None:
        return next(self._items, None)

    def _played(self, readings: np.ndarray, set_back_s: float) -> Iterator[Message | None]:
        yield message("info", {"array_id": ARRAY.name, "channels": ARRAY.n_channels})
        for k, row in enumerate(readings):
            if k % 100 == 0 and k:
                yield None
            at_s = 1e9 + k / 100 - set_back_s * (k >= 20)
            yield message("scan", {"timestamp": at_s, "volts": row.tolist(), "valid": [True] * 36})


def message(topic: str, data: dict[str, Any]) -> Message:
    return Message(topic, "b", 0, 0.0, data, 0.0, 0.0, 0.0)


def record(
    log: Path, monkeypatch: pytest.MonkeyPatch, readings: np.ndarray, least_s: float = 0.0
) -> tuple[GuidedLog, list[str]]:
    monkeypatch.setattr(guide, "Subscription", lambda *_, **__: PlayedSubscription(readings))
    monkeypatch.setattr(guide, "_LEAST_S", least_s)
    said: list[str] = []
    return guide.record_guided(log, "ipc:///none", None, None, 1.0, said.append), said


def test_prompts_until_nothing_is_lacking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, said = record(tmp_path / "log.npz", monkeypatch, runs("walk", "tip"))
    assert found.lacking == ""
    assert any("finger tip" in line for line in said)
    log = read_log(tmp_path / "log.npz")
    assert log.readings.shape == (found.scans, 36)
    assert found.scans > 1000
    assert log.time_s[-1] - log.time_s[0] == pytest.approx(found.duration_s)


def test_says_what_is_still_lacking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quiet = 1e-3 * np.random.default_rng(0).standard_normal((300, 36))
    found, said = record(tmp_path / "log.npz", monkeypatch, quiet)
    assert found.lacking in said[-1]
    assert "still lacking: press" in said[-1]


def test_a_recording_that_ends_before_creep_shows_lacks_no_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, said = record(tmp_path / "log.npz", monkeypatch, runs("walk", "tip"), least_s=15.0)
    assert found.lacking == ""
    assert said[-1].startswith(f"{tmp_path}/log.npz: {found.scans} scans. Stop")


def test_a_file_that_cannot_be_written_is_an_error_of_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "log.npz").mkdir()
    with pytest.raises(DataError, match="cannot be written: Is a directory"):
        record(tmp_path / "log.npz", monkeypatch, np.zeros((30, 36)))


def test_a_clock_that_is_set_back_ends_the_recording() -> None:
    played = cast(Subscription, PlayedSubscription(np.zeros((30, 36)), set_back_s=5.5))
    with pytest.raises(DataError, match=r"set back by 5\.5 s"):
        LiveScans(played, "ipc:///none", None, print).listen(1.0)


def test_no_scans_and_no_folder_are_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match="no scans"):
        record(tmp_path / "log.npz", monkeypatch, np.zeros((0, 36)))
    with pytest.raises(ConfigError, match="name an"):
        record(tmp_path / "log.csv", monkeypatch, np.zeros((0, 36)))
