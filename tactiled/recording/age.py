"""Ages of recordings, counted by the daemon itself while it runs beside them.

A wall clock may be wrong by months, ahead or behind: a host without a battery for it, a wrong date typed
in, a spoofed time server. So the age of a recording is the time that the host has run since a daemon first
saw it, by CLOCK_MONOTONIC, which nobody can set. Ages are kept in a file beside the recordings, with the
boot of the host that they were counted in. How long the host was off, nothing but the wall clock tells: a
pause between two boots counts as far as the clock says, and at most `PAUSE_PART` of the age at which
recordings are removed. One wrong clock at a boot makes all recordings older by at most that; and what comes
later is never older than what was there before, whatever dates they carry.
"""

import contextlib
import json
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tactiled import outside
from tactiled.errors import DataError

# Of `keep_days`. At 30 days a pause counts at most a day: a host that is used daily loses nothing, and its
# recordings are removed late by the weekends; thirty errors of the clock would have to come together.
PAUSE_PART = 1 / 30
FILE = "ages.json"
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_SAVE_S = 600.0  # between two writes: a kill makes recordings younger by so much
_MOST_BYTES = 16_000_000  # of a file that is read: the names of a quarter of a million recordings


class Ages:
    """Ages of the recordings in a directory.

    Parameters
    ----------
    pause_s : float
        The most that a pause between two boots counts.
    boot : str
        Name of the present boot; empty where it is not known.
    """

    def __init__(self, directory: Path, pause_s: float, boot: str) -> None:
        self._path = directory / FILE
        self._pause_s = pause_s
        self._boot = boot
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
            By the monotonic clock, and by the wall clock, which tells of pauses between two boots alone.
        """
        if self._last_s is None:
            saved = _load(self._path)
            self._ages_s = dict(saved.ages_s)
            if self._boot and saved.boot == self._boot:
                passed_s = max(now_s - saved.saved_s, 0.0)
            else:
                passed_s = min(max(now_unix_s - saved.saved_unix_s, 0.0), self._pause_s)
        else:
            passed_s = max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        before = self._ages_s
        self._ages_s = {name: before[name] + passed_s if name in before else 0.0 for name in names}
        if now_s >= self._next_save_s or self._ages_s.keys() != before.keys():
            self._next_save_s = now_s + _SAVE_S
            with contextlib.suppress(OSError):  # on a full disk, recordings must be removed all the same
                self._save(_Saved(self._ages_s, now_unix_s, now_s, self._boot))
        return self._ages_s

    def _save(self, saved: "_Saved") -> None:
        new = self._path.with_suffix(".part")
        new.unlink(missing_ok=True)  # of an earlier run, or a link that somebody laid there
        with new.open("x", encoding="utf-8") as stream:
            json.dump(saved._asdict(), stream)
            stream.flush()
            os.fsync(stream.fileno())
        new.replace(self._path)


class _Saved(NamedTuple):
    """Ages, and the clocks and the boot at which they were saved."""

    ages_s: Mapping[str, float]
    saved_unix_s: float
    saved_s: float
    boot: str


def boot_id() -> str:
    """Return the name that the kernel gave to the present boot; empty without one."""
    with contextlib.suppress(OSError):
        return _BOOT_ID.read_text(encoding="ascii").strip()
    return ""


def _load(path: Path) -> _Saved:
    """Return what was saved; no ages where the file is not ours to read."""
    nothing = _Saved({}, math.inf, math.inf, "")
    try:
        document: Any = outside.json_of(outside.read_text(path, _MOST_BYTES))
        ages_s = {str(name): float(age_s) for name, age_s in document["ages_s"].items()}
        clocks = float(document["saved_unix_s"]), float(document["saved_s"])
        boot = str(document["boot"])
    except (OSError, DataError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return nothing
    if not all(map(math.isfinite, clocks)) or not all(0.0 <= age_s < math.inf for age_s in ages_s.values()):
        return nothing
    return _Saved(ages_s, *clocks, boot)
