"""Whatever happens to the line, scans and bytes are accounted for, and nothing old is called fresh."""

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from scan_accounting import ScanAccounting
from simulated_link import SimulatedLink, grasps

from tactiled.array import load_array
from tactiled.daemon.board.session import SessionParams
from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.line.faults import FaultKind, FaultParams
from tactiled.events.types import Event, StatusEvent
from tactiled.wire.layout import load_layout

LAYOUT = load_layout("board-v1")
ARRAY = load_array("wang2019-3x3")
SCENE = grasps(600.0)
KINDS: tuple[FaultKind, ...] = (
    "flip", "drop", "cut", "duplicate", "burst", "stall", "overrun", "reboot", "unplug",
)  # fmt: skip
RATE_HZ = 50.0  # not the board's own: it is one of the settings that must come back
SILENCE_S = 0.1  # of five scans
CLOCK_S = 0.02  # hand-overs of 16 ms, before the fit knows


class AnyFaults(RuleBasedStateMachine):
    """Board link on an emulated port in simulated time, with faults at any moment, also overlapping."""

    @initialize(
        stall_s=st.sampled_from([0.03, 0.5, 2.0]),
        unplug_s=st.sampled_from([0.02, 0.3, 3.0]),
        bunch_s=st.sampled_from([0.0, 0.001, 0.016]),
        burst_bytes=st.sampled_from([1, 40, 400]),
        seed=st.integers(0, 1000),
    )
    def set_up(self, stall_s: float, unplug_s: float, bunch_s: float, burst_bytes: int, seed: int) -> None:
        self.accounting = ScanAccounting(RATE_HZ, 2 * SILENCE_S + CLOCK_S)
        self.statuses: list[StatusEvent] = []
        self.rig = SimulatedLink(
            SCENE,
            LAYOUT,
            ARRAY,
            board=EmulatedBoardParams(drift_ppm=-40.0),
            faults=FaultParams(stall_s=stall_s, unplug_s=unplug_s, bunch_s=bunch_s, burst_bytes=burst_bytes),
            seed=seed,
            session=SessionParams(rate_hz=RATE_HZ),
            publish=self._published,
            on_scan=self.accounting.taken,
        )

    def _published(self, event: Event) -> None:
        self.accounting.published(event)
        if isinstance(event, StatusEvent):
            self.statuses.append(event)

    @rule(kind=st.sampled_from(KINDS))
    def fault(self, kind: FaultKind) -> None:
        self.rig.inflict(kind)

    @rule(duration_s=st.sampled_from([0.004, 0.02, 0.06, 0.15, 0.4, 1.5]))
    def wait(self, duration_s: float) -> None:
        self.rig.run_until(self.rig.now_s + duration_s)

    @invariant()
    def bytes_add_up(self) -> None:
        if hasattr(self, "rig"):
            health = self.rig.pipeline.health()
            decided = health.bytes_framed + health.bytes_discarded + health.bytes_pending
            assert health.bytes_in == decided == self.rig.bytes_read

    def teardown(self) -> None:
        if not hasattr(self, "rig"):
            return
        rig, account = self.rig, self.accounting.counts
        rig.run_until(rig.now_s + 8.0)  # the longest stall, unplug and recovery are over
        status = rig.status()
        self.accounting.close()
        assert (status.state, status.valid, status.rate_hz) == ("running", True, RATE_HZ)
        assert account.taken == account.delivered + account.lost_in_runs + account.lost_at_restarts
        assert account.lost_in_runs == status.scans_missing
        assert account.delivered == status.scans
        counts = rig.port.counts
        if not counts.reboots and not counts.unplugs:  # a damaged frame costs itself only
            assert account.lost_in_runs <= counts.frames_damaged + counts.overruns
        assert (account.repeated, account.false_fresh) == (0, 0)
        assert status.restarts <= counts.reboots
        assert {s.state for s in self.statuses if s.valid} <= {"running"}


AnyFaults.TestCase.settings = settings(max_examples=12, stateful_step_count=20, deadline=None)
TestAnyFaults = AnyFaults.TestCase
