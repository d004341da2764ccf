"""Removal of old recordings from the record directory: by size, and by the age that recordings prove."""

from dataclasses import dataclass
from pathlib import Path

from tactiled.recording.age import PAUSE_PART, SpanCache, proven_ages_s
from tactiled.recording.directory import DAY_S, Finished, finished, surplus


@dataclass(frozen=True)
class Retained:
    """Outcome of one check.

    Attributes
    ----------
    removed : list of Finished
    unproven : str
        Why files that are too old by the clock of this host were kept; empty where there are none.
    """

    removed: list[Finished]
    unproven: str


class Retention:
    """Limits of a record directory, kept by removing its oldest recordings.

    Parameters
    ----------
    directory : Path
    keep_mb, keep_days : float, optional
        Limits of total size (10^6 bytes) and of age; None is no limit.
    """

    def __init__(self, directory: Path, keep_mb: float | None, keep_days: float | None) -> None:
        self._directory = directory
        self._keep_mb = keep_mb
        self._keep_days = keep_days
        self._spans = SpanCache()

    def check(self, now_unix_s: float) -> Retained:
        """Remove what exceeds a limit; the time of the wall clock explains only what is kept.

        Raises
        ------
        OSError
            The directory cannot be read, or a file in it cannot be removed.
        """
        if self._keep_mb is None and self._keep_days is None:
            return Retained([], "")
        files = finished(self._directory)
        ages_s: dict[Path, float] = {}
        if self._keep_days is not None:
            ages_s = proven_ages_s(self._spans.of(files), self._keep_days * DAY_S * PAUSE_PART)
        removed = surplus(files, self._keep_mb, self._keep_days, ages_s)
        for file in removed:
            file.path.unlink(missing_ok=True)
        kept = [file for file in files if file not in removed]
        return Retained(removed, self._unproven(kept, ages_s, now_unix_s))

    def _unproven(self, kept: list[Finished], ages_s: dict[Path, float], now_unix_s: float) -> str:
        if self._keep_days is None:
            return ""
        limit_s = self._keep_days * DAY_S
        n_old = sum(now_unix_s - file.ended_unix_s > limit_s for file in kept)
        if not n_old:
            return ""
        most_days = max(ages_s.values(), default=0.0) / DAY_S
        return (
            f"{n_old} recordings in {self._directory} are older than record.keep_days = "
            f"{self._keep_days:g} by the clock of this host, which may be wrong; they are kept, because "
            f"recordings prove an age of {most_days:.3g} days (a pause between them counts at most "
            f"{self._keep_days * PAUSE_PART:.3g} days)"
        )
