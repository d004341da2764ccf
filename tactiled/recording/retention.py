"""Removal of old recordings from the record directory: by size, and by the age that was counted."""

from dataclasses import dataclass
from pathlib import Path

from tactiled.recording.age import PAUSE_PART, Ages, boot_id
from tactiled.recording.directory import DAY_S, Finished, finished, surplus


@dataclass(frozen=True)
class Retained:
    """Outcome of one check.

    Attributes
    ----------
    unproven : str
        Why files that are too old by the clock of this host were kept; empty where there are none.
    """

    removed: list[Finished]
    unproven: str


class Retention:
    """Limits of a record directory, kept by removing its oldest recordings.

    Parameters
    ----------
    keep_mb, keep_days : float, optional
        Limits of total size (10^6 bytes) and of age; None is no limit.
    boot : str, optional
        Name of the present boot of the host; by default what the kernel says.
    """

    def __init__(
        self, directory: Path, keep_mb: float | None, keep_days: float | None, boot: str | None = None
    ) -> None:
        self._directory = directory
        self._keep_mb = keep_mb
        self._keep_days = keep_days
        self._ages = Ages(
            directory, (keep_days or 0.0) * DAY_S * PAUSE_PART, boot_id() if boot is None else boot
        )

    def check(self, now_s: float, now_unix_s: float) -> Retained:
        """Count ages, and remove what exceeds a limit.

        Parameters
        ----------
        now_s : float
            By the monotonic clock.
        now_unix_s : float
            By the wall clock, which explains what is kept.

        Raises
        ------
        OSError
            The directory cannot be read, or a file in it cannot be removed.
        """
        if self._keep_mb is None and self._keep_days is None:
            return Retained([], "")
        files = finished(self._directory)
        ages_s = self._ages.advance([file.path.name for file in files], now_s, now_unix_s)
        removed = surplus(files, self._keep_mb, self._keep_days, ages_s)
        for file in removed:
            file.path.unlink(missing_ok=True)
        kept = [file for file in files if file not in removed]
        return Retained(removed, self._unproven(kept, max(ages_s.values(), default=0.0), now_unix_s))

    def _unproven(self, kept: list[Finished], most_s: float, now_unix_s: float) -> str:
        if self._keep_days is None:
            return ""
        limit_s = self._keep_days * DAY_S
        n_old = sum(now_unix_s - file.ended_unix_s > limit_s for file in kept)
        if not n_old:
            return ""
        return (
            f"{n_old} recordings in {self._directory} are older than record.keep_days = "
            f"{self._keep_days:g} by the clock of this host, which may be wrong; they are kept, because "
            f"tactiled has counted {most_s / DAY_S:.3g} days beside the oldest (a pause between two runs "
            f"counts at most {self._keep_days * PAUSE_PART:.3g} days)"
        )
