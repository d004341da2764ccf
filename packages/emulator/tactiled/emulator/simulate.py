"""The emulator in simulated time, with a clock that jumps from deadline to deadline."""

from collections.abc import Iterator

from tactiled.emulator.board.identity import EmulatedBoardParams
from tactiled.emulator.board.scanning import ScanTruth
from tactiled.emulator.control import move_grip
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import Scene
from tactiled.emulator.scene.truth import Truth
from tactiled.errors import ContractError
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Command
from tactiled.wire.layout import Layout

_POWER_UP_S = 1000.0  # simulated monotonic time
# Time after the stop at the end of the scene in which the last bytes arrive.
_DRAIN_S = 0.2


class Simulation:
    """Iterator over ``(arrival_s, bytes)`` in order, which has the truth afterwards.

    It acts as host, too: it starts the board whenever bytes come and it does not run (also after a reset),
    and stops it at the end. `seed` is of the faults; the scene has its own. `duration_s` of the scene are
    played, by default all of it.
    """

    def __init__(
        self,
        scene: Scene,
        layout: Layout,
        *,
        board: EmulatedBoardParams | None = None,
        faults: FaultParams | None = None,
        seed: int = 0,
        duration_s: float | None = None,
    ) -> None:
        faults = faults or FaultParams()
        self.now_s = _POWER_UP_S
        self.scans: list[ScanTruth] = []  # truth about each scan instant so far
        self._scene = scene
        self._duration_s = scene.duration_s if duration_s is None else duration_s
        self._drain_s = _DRAIN_S + faults.bunch_s + faults.stall_s
        self._encoder = Encoder(layout)
        self._is_host = layout.has("start")  # a board without commands runs by itself
        self._starts_unasked = self._is_host and not layout.has("hello")  # such a board says nothing before
        self._token = 0
        note = self.scans.append
        self._port = EmulatedPort(
            scene, layout, power_up_s=_POWER_UP_S, board=board, faults=faults, seed=seed, on_scan=note
        )
        self.counts = self._port.counts  # of the faults so far

    @property
    def truth(self) -> Truth:
        """Truth of the scene on the simulated clock; `ContractError` before the scene has begun."""
        t0_s = self._port.board.scene_start_s
        if t0_s is None:
            raise ContractError("the scene has not begun: iterate the simulation first")
        return Truth(self._scene, t0_s, self._port.contact)

    def grip(self, force_n: float) -> None:
        """Set a controller's grip on a held object from now on; see `move_grip`."""
        move_grip(self._port.contact, force_n)

    def __iter__(self) -> Iterator[tuple[float, bytes]]:
        yield from self._until_end()
        if self._is_host:
            self._is_host = False
            self._command("stop")
        self._duration_s += self._drain_s
        yield from self._until_end()

    def _until_end(self) -> Iterator[tuple[float, bytes]]:
        while (due_s := self._port.next_deadline_s()) <= self._end_s():
            self.now_s = due_s
            arrivals = self._port.advance(due_s)
            if self._is_host and self._starts_unasked and not self._port.board.running:
                self._command("start")
            for arrival in arrivals:
                if self._is_host and not self._port.board.running:
                    self._command("start")
                yield arrival
        self.now_s = self._end_s()

    def _end_s(self) -> float:
        t0_s = self._port.board.scene_start_s
        return (_POWER_UP_S if t0_s is None else t0_s) + self._duration_s

    def _command(self, name: str) -> None:
        self._token = (self._token + 1) % 256  # fits a token of any width
        self._port.receive(self._encoder.encode(Command(name, self._token)), self.now_s)
