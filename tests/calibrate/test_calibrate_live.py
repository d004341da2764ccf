"""Guided recording: prompts of the guide, and a log that can be fitted."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.calibrate import live
from tactiled.calibrate.files import read_log
from tactiled.client.items import Message
from tactiled.emulator.rig.session import draw_rig
from tactiled.errors import ConfigError, DataError

ARRAY = load_array("wang2019-3x3")


class PlayedSubscription:
    """Subscription to a daemon whose board plays a rig; a second of scans at each look."""

    def __init__(self, readings: np.ndarray) -> None:
        self._items = self._played(readings)

    def __enter__(self) -> "PlayedSubscription":
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def next_item(self, _until_s: float) -> Message | None:
        return next(self._items, None)

    def _played(self, readings: np.ndarray) -> Iterator[Message | None]:
        yield message("info", {"array_id": ARRAY.name, "channels": ARRAY.n_channels})
        for k, row in enumerate(readings):
            if k % 100 == 0 and k:
                yield None
            yield message("scan", {"timestamp": 1e9 + k / 100, "volts": row.tolist(), "valid": [True] * 36})


def message(topic: str, data: dict[str, Any]) -> Message:
    return Message(topic, "b", 0, 0.0, data, 0.0, 0.0, 0.0)


def record(
    log: Path, monkeypatch: pytest.MonkeyPatch, readings: np.ndarray
) -> tuple[live.GuidedLog, list[str]]:
    monkeypatch.setattr(live, "Subscription", lambda *_, **__: PlayedSubscription(readings))
    monkeypatch.setattr(live, "_LEAST_S", 0.0)
    said: list[str] = []
    return live.record_guided(log, "ipc:///none", None, None, 1.0, said.append), said


def test_prompts_until_nothing_is_lacking(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig, rng = draw_rig(ARRAY, 2)
    runs = [rig.run(motion, 60.0, rng).readings for motion in ("walk", "tip")]
    found, said = record(tmp_path / "log.npz", monkeypatch, np.concatenate(runs))
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


def test_no_scans_and_no_folder_are_errors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match="no scans"):
        record(tmp_path / "log.npz", monkeypatch, np.zeros((0, 36)))
    with pytest.raises(ConfigError, match="name an"):
        record(tmp_path / "log.csv", monkeypatch, np.zeros((0, 36)))
