"""Readable extent of a recording and the damage within it."""

from dataclasses import dataclass, field

from tactiled.recording.contents import Input, damage_mark


@dataclass(frozen=True)
class Damage:
    """Unreadable stretch in the middle of a file.

    Attributes
    ----------
    first_unix_s, last_unix_s : float
        Epoch times of the messages before and after it; equal where the duration is unknown.
    """

    n_bytes: int
    first_unix_s: float
    last_unix_s: float

    @property
    def duration_s(self) -> float:
        """Time between the messages before and after it."""
        return max(self.last_unix_s - self.first_unix_s, 0.0)

    def mark(self) -> Input:
        """Return the `Input` that marks this stretch for the pipeline."""
        return damage_mark(self.first_unix_s, self.n_bytes, self.duration_s)


@dataclass
class Extent:
    """Readable extent of a file, updated while the file is read.

    Attributes
    ----------
    good_bytes : int
        Offset of the end of the last whole record that carries data.
    is_complete : bool
        The end-of-data record was found: nothing is cut off.
    torn_s : tuple of float, optional
        First and last epoch time of the incomplete chunk at the end, if its header is there.
    damages : list of Damage
        Unreadable stretches before the end.
    orphans : int
        Number of messages whose channel description is lost.
    """

    good_bytes: int = 0
    size_bytes: int = 0
    is_complete: bool = False
    torn_s: tuple[float, float] | None = None
    damages: list[Damage] = field(default_factory=list)
    orphans: int = 0

    @property
    def share_read(self) -> float:
        """Fraction of the file that was read, 0 to 1."""
        return self.good_bytes / self.size_bytes if self.size_bytes else 0.0

    @property
    def is_whole(self) -> bool:
        """The file is complete and undamaged."""
        return self.is_complete and not self.is_damaged

    @property
    def is_damaged(self) -> bool:
        """Data before the end is missing."""
        return bool(self.damages or self.orphans)

    def words(self) -> str:
        """Describe what could not be read; empty where everything was read."""
        words = []
        if self.damages:
            n_bytes = sum(damage.n_bytes for damage in self.damages)
            duration_s = sum(damage.duration_s for damage in self.damages)
            places = "one place" if len(self.damages) == 1 else f"{len(self.damages)} places"
            words.append(f"{n_bytes} bytes in {places} are damaged: about {duration_s:.2f} s are missing")
        if self.orphans:
            words.append(f"{self.orphans} messages have no channel description")
        if not self.is_complete:
            rest = self.size_bytes - self.good_bytes
            words.append(
                f"the file was not finished or was truncated; {rest} bytes at its end cannot be read"
            )
        return "; ".join(words)
