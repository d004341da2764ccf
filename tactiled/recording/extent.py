"""How far a recording is good, and what is missing in its middle, in numbers and in words."""

from dataclasses import dataclass, field

from tactiled.recording.contents import Input, damage_mark


@dataclass(frozen=True)
class Damage:
    """A stretch in the middle of a file that cannot be read.

    Attributes
    ----------
    n_bytes : int
    first_unix_s, last_unix_s : float
        Instants (epoch) of the messages beside it; equal where nobody can say how long it was.
    """

    n_bytes: int
    first_unix_s: float
    last_unix_s: float

    @property
    def duration_s(self) -> float:
        return max(self.last_unix_s - self.first_unix_s, 0.0)

    def mark(self) -> Input:
        """What stands in its place among the inputs of the pipeline."""
        return damage_mark(self.first_unix_s, self.n_bytes, self.duration_s)


@dataclass
class Extent:
    """How far a file is good; filled while it is read.

    Attributes
    ----------
    good_bytes : int
        Up to the end of the last whole record that carries data.
    size_bytes : int
    is_complete : bool
        The end of the data was found: nothing is cut off.
    torn_s : tuple of float, optional
        First and last instant (epoch) in the chunk at the end that is not whole, if its head is there.
    damages : list of Damage
        Stretches before the end that cannot be read.
    orphans : int
        Messages of which nobody knows any more what they are.
    other_forms : set of str
        Topics whose events have the form of another version, and are left out: raw bytes make them anew.
    """

    good_bytes: int = 0
    size_bytes: int = 0
    is_complete: bool = False
    torn_s: tuple[float, float] | None = None
    damages: list[Damage] = field(default_factory=list)
    orphans: int = 0
    other_forms: set[str] = field(default_factory=set)

    @property
    def share_read(self) -> float:
        """Part of the file that was read, 0 to 1."""
        return self.good_bytes / self.size_bytes if self.size_bytes else 0.0

    @property
    def is_whole(self) -> bool:
        """All that was ever written was read."""
        return self.is_complete and not self.is_damaged

    @property
    def is_damaged(self) -> bool:
        """Something is missing before the end."""
        return bool(self.damages or self.orphans)

    def other_words(self) -> str:
        """What another version wrote; empty where that is nothing."""
        topics = ", ".join(sorted(self.other_forms))
        return f"events of {topics} have the form of another tactiled: left out" if topics else ""

    def words(self) -> str:
        """What could not be read; empty where that is nothing."""
        words = []
        if self.damages:
            n_bytes = sum(damage.n_bytes for damage in self.damages)
            duration_s = sum(damage.duration_s for damage in self.damages)
            places = "one place" if len(self.damages) == 1 else f"{len(self.damages)} places"
            words.append(f"{n_bytes} bytes in {places} are damaged: some {duration_s:.2f} s are missing")
        if self.orphans:
            words.append(f"{self.orphans} messages cannot be told what they are")
        if not self.is_complete:
            rest = self.size_bytes - self.good_bytes
            words.append(f"it was not finished, or was cut; {rest} bytes at its end cannot be read")
        return "; ".join(words)
