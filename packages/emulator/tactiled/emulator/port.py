"""Board, sensor, line and faults as one sans-I/O object.

`simulate` drives it in simulated time, `realtime` on the host's clock.
"""

from collections.abc import Callable

from tactiled.array import Array
from tactiled.emulator.board.firmware import Board
from tactiled.emulator.board.identity import EmulatedBoardParams, emulated_array, identity
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.board.sensor import Sensor
from tactiled.emulator.line.cable import Arrival, CableModel
from tactiled.emulator.line.faults import FaultCounts, FaultKind, FaultParams, FaultPlan
from tactiled.emulator.scene.description import Scene
from tactiled.wire.layout import Layout


class EmulatedPort:
    """An emulated board at the end of an emulated cable, powered up at a true instant (host monotonic clock).

    `seed` is of the faults; the scene has its own. `on_scan` gets a `ScanTruth` for each scan instant. The
    constructor raises `ConfigError` where scene, array, layout and board do not fit each other.
    """

    def __init__(
        self,
        scene: Scene,
        layout: Layout,
        *,
        power_up_s: float,
        board: EmulatedBoardParams | None = None,
        faults: FaultParams | None = None,
        seed: int = 0,
        on_scan: Callable[[ScanTruth], None] = lambda _: None,
    ) -> None:
        params, self._faults = board or EmulatedBoardParams(), faults or FaultParams()
        array = emulated_array(scene, layout)
        hello = identity(params, layout, array)
        sensor = Sensor(
            scene,
            array,
            adc_bits=hello.adc_bits,
            adc_reference_v=hello.adc_reference_v,
            span=_span(array, hello.adc_reference_v) if layout.carries_units else None,
        )
        self.contact = sensor.contact  # source of the truth; takes a controller's grip
        self.board = Board(layout, hello, params, sensor, power_up_s=power_up_s, on_scan=self._scanned)
        self._on_scan = on_scan
        self.counts = FaultCounts()
        self.plugged = True  # False while a fault has unplugged the port: a host can use none
        self._line = CableModel(layout.file.baud, self._faults, seed, self.counts)
        self._plan = FaultPlan(self._faults, seed, power_up_s)
        self._replug_s = float("inf")
        self._out: list[Arrival] = []

    def next_deadline_s(self) -> float:
        """True instant of the next event in `advance`."""
        return min(self._next_event_s(), self._line.next_arrival_s())

    def advance(self, now_s: float) -> list[Arrival]:
        """Advance to an instant and return the bytes that arrived at the host, in order."""
        self._run_until(now_s)
        out, self._out = self._out, []
        return out

    def step(self, now_s: float) -> list[Arrival]:
        """Do the first event that is due, if any, and return the bytes that arrived before the next one."""
        arrived = self.advance(min(self._next_event_s(), now_s))
        return arrived + self._line.arrivals(min(self._next_event_s(), now_s))

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes that the host wrote; they reach the board at once."""
        self._run_until(now_s)
        if self.plugged:
            self.board.receive(data, now_s)
            self._collect(now_s)

    def inflict(self, kind: FaultKind, now_s: float) -> None:
        """Cause a fault now; a fault of a frame changes the next one sent."""
        self._run_until(now_s)
        self._inflict(kind, now_s)

    def _next_event_s(self) -> float:
        return min(self.board.next_deadline_s(), self._plan.next_s(), self._replug_s)

    def _run_until(self, now_s: float) -> None:
        while (due_s := self._next_event_s()) <= now_s:
            self._out += self._line.arrivals(due_s)
            self._collect(due_s)
            if self._replug_s <= due_s:
                self.plugged, self._replug_s = True, float("inf")
            if self._plan.next_s() <= due_s:
                self._inflict(self._plan.pop(), due_s)
        self._out += self._line.arrivals(now_s)

    def _collect(self, now_s: float) -> None:
        """Send the frames that are ready; they are lost while the adapter is unplugged."""
        for frame in self.board.advance(now_s):
            if self.plugged:
                self._line.send(frame.ready_s, frame.data)
            else:
                self.counts.frames_unplugged += 1

    def _scanned(self, scan: ScanTruth) -> None:
        self.counts.overruns += not scan.sent
        self._on_scan(scan)

    def _inflict(self, kind: FaultKind, now_s: float) -> None:
        if kind == "stall":
            self._line.stall(now_s + self._faults.stall_s)
            self.counts.stalls += 1
        elif kind == "overrun":
            self.board.miss_scan(now_s)
        elif kind == "reboot":
            self.board.reboot(now_s)
            self.counts.reboots += 1
        elif kind == "unplug":
            if self.plugged:
                self.plugged, self._replug_s = False, now_s + self._faults.unplug_s
                self.counts.unplugs += 1
                self._line.pull_out()
        else:
            self._line.arm(kind)


def _span(array: Array, adc_reference_v: float) -> tuple[float, float]:
    """Return the readings of no and of all counts, in the unit of the array: volts are those at the ADC."""
    return (0.0, adc_reference_v) if array.unit == "V" else (array.low, array.high)
