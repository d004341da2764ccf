"""Ages of recordings, counted by the daemon itself while it runs beside them.

A wall clock may be wrong by months, ahead or behind: a host without a battery for it, a wrong date typed in,
a spoofed time server. So the age of a recording is the time that a daemon has run since it first saw it, by
CLOCK_MONOTONIC, which nobody can set. Ages are kept in a file beside the recordings. How long the host was
off, nothing but the wall clock tells: a pause between two runs counts as far as the clock says, and at most
`PAUSE_PART` of the age at which recordings are removed. One wrong clock makes all recordings older by at most
that; and what comes later is never older than what was there before, whatever dates they carry.
"""

import contextlib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from tactiled import outside
from tactiled.errors import DataError

# Of `keep_days`. At 30 days a pause counts at most a day: a host that is used daily loses nothing, and its
# recordings are removed late by the weekends; thirty errors of the clock would have to come together.
PAUSE_PART = 1 / 30
FILE = "ages.json"
_SAVE_S = 600.0  # between two writes: a kill makes recordings younger by so much
_MOST_BYTES = 16_000_000  # of a file that is read: the names of a quarter of a million recordings


class Ages:
    """Ages of the recordings in a directory.

    Parameters
    ----------
    directory : Path
    pause_s : float
        The most that a pause between two runs counts.
    """

    def __init__(self, directory: Path, pause_s: float) -> None:
        self._path = directory / FILE
        self._pause_s = pause_s
        self._ages_s: dict[str, float] = {}
        self._last_s: float | None = None
        self._next_save_s = -math.inf

    def advance(self, names: Iterable[str], now_s: float, now_unix_s: float) -> Mapping[str, float]:
        """Count the time since the last call; return the age (s) of each recording.

        Parameters
        ----------
        names : iterable of str
            Recordings that are there; new ones begin at 0.
        now_s, now_unix_s : float
            By the monotonic clock, and by the wall clock, which tells of pauses between two runs alone.
        """
        if self._last_s is None:
            self._ages_s, saved_unix_s = _load(self._path)
            passed_s = min(max(now_unix_s - saved_unix_s, 0.0), self._pause_s)
        else:
            passed_s = max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        before = self._ages_s
        self._ages_s = {name: before[name] + passed_s if name in before else 0.0 for name in names}
        if now_s >= self._next_save_s or self._ages_s.keys() != before.keys():
            self._next_save_s = now_s + _SAVE_S
            with contextlib.suppress(OSError):  # on a full disk, recordings must be removed all the same
                self._save(now_unix_s)
        return self._ages_s

    def _save(self, now_unix_s: float) -> None:
        new = self._path.with_suffix(".part")
        new.write_text(json.dumps({"saved_unix_s": now_unix_s, "ages_s": self._ages_s}), encoding="utf-8")
        new.replace(self._path)


def _load(path: Path) -> tuple[dict[str, float], float]:
    """Ages and the wall clock at which they were saved; none where the file is not ours to read."""
    nothing: tuple[dict[str, float], float] = {}, math.inf
    try:
        document: Any = outside.json_of(outside.read_text(path, _MOST_BYTES))
        saved_unix_s = float(document["saved_unix_s"])
        ages_s = {str(name): float(age_s) for name, age_s in document["ages_s"].items()}
    except (OSError, DataError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return nothing
    if not math.isfinite(saved_unix_s) or not all(0.0 <= age_s < math.inf for age_s in ages_s.values()):
        return nothing
    return ages_s, saved_unix_s
