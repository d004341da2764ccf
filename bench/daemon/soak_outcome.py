"""What a stretch of `bench soak` came to, and what of it is not as it must be."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from bench.daemon.ledger import Account
from tactiled.emulator.line.faults import FaultCounts, FaultParams
from tactiled.emulator.scene.truth import Truth
from tactiled.pipeline import Health

_NEAR_S = 2.0  # an onset this near to a true slide is that slide's


@dataclass(frozen=True)
class Stretch:
    """A length of board time under one line."""

    name: str
    rate_hz: float
    duration_s: float
    faults: FaultParams
    seed: int = 0


@dataclass(frozen=True)
class Onset:
    """Of a valid slip.

    Attributes
    ----------
    at_s : float
    is_contact_known : bool
        The contact that slipped was seen from its beginning.
    is_stale : bool
        Its evidence was handled too late.
    """

    at_s: float
    is_contact_known: bool
    is_stale: bool


@dataclass
class Outcome:
    """What a stretch came to."""

    stretch: Stretch
    account: Account
    health: Health
    counts: FaultCounts
    bytes_read: int = 0
    true_slips: int = 0
    slips_found: int = 0
    false_slips: int = 0
    unsure_slips: int = 0
    """False ones out of a contact whose beginning nobody saw: there the end of a slide may look like one."""
    stale_slips: int = 0
    """Whose evidence was handled too late."""
    rms_s: list[float] = field(default_factory=list)
    """Errors of instants, tenth by tenth."""
    rss_mb: list[float] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)
    """Objects that Python holds."""
    took_s: float = 0.0

    def score(self, truth: Truth, onsets: Sequence[Onset]) -> None:
        """Which slips were found, and which never were."""
        found = set()
        for onset in onsets:
            near = [
                k
                for k, slip in enumerate(truth.slips)
                if slip.onset_s - _NEAR_S <= onset.at_s <= slip.end_s + _NEAR_S
            ]
            found.update(near)
            self.false_slips += not near and onset.is_contact_known
            self.unsure_slips += not near and not onset.is_contact_known
            self.stale_slips += onset.is_stale
        self.true_slips, self.slips_found = len(truth.slips), len(found)

    @property
    def unaccounted(self) -> int:
        """Scans that nobody accounts for, or losses that were not counted as they were."""
        account = self.account
        known = account.delivered + account.lost_in_runs + account.lost_at_restarts
        return abs(account.taken - known) + abs(account.lost_in_runs - self.health.scans_missing)

    @property
    def faults(self) -> list[str]:
        """What is not as it must be; empty when all is."""
        account, health = self.account, self.health
        decided = health.bytes_framed + health.bytes_discarded + health.bytes_pending
        checks = {
            "scans are not accounted for": self.unaccounted,
            "bytes do not add up": not health.bytes_in == decided == self.bytes_read,
            "a scan was published twice": account.repeated,
            "an instant was wrong": account.mistimed,
            "old news were called fresh": account.false_fresh,
            "a slip was false": self.false_slips,
            "a valid slip came of old scans": self.stale_slips,
            "reboots were not counted as such": health.restarts != self.counts.reboots,
        }
        return [words for words, wrong in checks.items() if wrong]
