"""Online groove estimator by the joint fit ("joint"): an early answer that later fits refine.

`fit` holds the fit of one window and `track` follows its wave to the next; this module manages the window.

* A window begins `settle_s` after the scan that detected slip, grows to `max_window_s`, then slides. It is
  fitted every `hop_s`, counted in scans, so the arithmetic does not depend on how scans were chunked.
* Each fit is handed to a worker, and its answer is reported `answer_after_s` after the end of its window, at
  a fixed scan. A fit that is not ready by then is reported as "stale".
* Once there is an answer, its wave is tracked. The window is fitted anew when it has doubled or, at its full
  length, when all its scans are new, and at every hop without an answer or with more than one wave in view.
  Another pattern under the skin is reported as "ambiguous" and begins a new window.
* The first answer comes when the number of periods and both standard deviations meet the criteria, or when
  the window has its full length; then one follows at every hop. A refusal comes when an answer is lost, when
  the window is full and after every further full length, and at the end of a slip that had no answer.
* A given speed ties the frequency to the wave vector, and windows are measured in distance travelled, so that
  a varying speed does not smear the line. Without one (0) the speed is estimated. A new window begins where
  the speed changes sign, becomes known or becomes unknown.
* The direction is that of the slip event, unless configured. Where neither is known, no speed is estimated.
* Where phases cannot tell an angle, `fit` may answer "period-only" (`period_only`), which is reported at
  every hop. No answer is "ok" while its standard deviation is a quarter of the period or more.
* With two gratings in view there is no answer but "several-gratings".
"""

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveMotion, channel_layout
from tactiled.detect.grooves.outcome import (
    FitSpan,
    GrooveAnswer,
    NewPattern,
    Outcome,
    PeriodOnly,
    Refusal,
    texture_event,
)
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.grooves.track import track_wave
from tactiled.detect.grooves.window import FitWindow, PendingFit, ScanWindow, SlideWindow
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.slip_gate import SlidingScans, SlipEnd, SlipGate, SlipStart
from tactiled.detect.worker import InPlace, Worker
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock

# derived: of the period. Two gratings that differ by less could not be told apart at two standard deviations.
_LARGEST_SD_PART = 0.25
WindowFit = Callable[[FitWindow], Outcome]
# physical: grooves deflect friction, and with it the direction of the slip event: by up to 5 degrees on
# physical scenes.
_GROOVES_TURN_DEG = 3.0


class JointTexture:
    """Report texture events by the joint fit.

    Parameters
    ----------
    worker : Worker, optional
        Computes the fits; by default they are computed in place.
    fit : callable
        Fits one window: `fit_wave`, or another with its parameters and result.
    looks_back_s : float
        See `SlipGate`.
    widest : int
        How many times its full length a window may have, while it holds too few periods.

    Examples
    --------
    Grooves of 1.2 mm at 20 degrees under a slip along +x that is detected at the first scan:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.events.types import SlipEvent
    >>> from tactiled.samples.block import regular_block
    >>> array, rng, angle = load_array("wang2019-3x3"), np.random.default_rng(0), np.radians(20)
    >>> x_mm = array.x_mm[array.channel_taxel] + 2 * np.arange(200)[:, np.newaxis] / 100
    >>> y_mm = array.y_mm[array.channel_taxel]
    >>> phase = 2 * np.pi / 1.2 * (x_mm * np.cos(angle) + y_mm * np.sin(angle)) + np.arange(36) % 4
    >>> volts = 1 + 0.05 * np.cos(phase) + 0.005 * rng.standard_normal(phase.shape)
    >>> block = regular_block(volts, 100.0)
    >>> slip = SlipEvent(
    ...     time_s=0.0, state="onset", kind="gross", onset_s=0.0, onset_sd_s=0.01,
    ...     direction_deg=0.0, direction_sd_deg=1.0, confidence=1.0, taxels=(), detector="grip",
    ...     statistic=1.0, threshold=0.0, valid=True, detected_s=0.0,
    ... )
    >>> events = JointTexture(array, JointParams(speed_mm_s=2.0)).process(block, [slip])
    >>> for event in (events[0], events[-1]):
    ...     print(f"{event.answered_s:.2f} s: {event.period_mm:.3f} mm, {event.angle_deg:.1f} degrees")
    1.49 s: 1.200 mm, 20.0 degrees
    1.89 s: 1.200 mm, 20.0 degrees
    """

    def __init__(
        self,
        array: Array,
        params: JointParams | None = None,
        worker: Worker | None = None,
        fit: WindowFit = fit_wave,
        looks_back_s: float = 0.0,
        widest: int = 1,
    ) -> None:
        self._fit = fit
        self._widest = widest
        self._looks_back_s = looks_back_s
        self._layout = channel_layout(array)
        self._full_scale_volts = Quantiser(array).full_scale_volts
        self._params = params or JointParams()
        self._worker = worker or InPlace()
        self.reset()

    def reset(self) -> None:
        """Discard all scans and the speeds set since construction; keep the parameters."""
        self._gate = SlipGate(self._params.settle_s, self._params.speed_mm_s, self._looks_back_s)
        self._pending: deque[PendingFit] = deque()
        self._told_late: set[int] = set()
        self._late: list[int] = []
        self._end_slip()

    def _end_slip(self) -> None:
        self._slip_speed_sign = 0.0
        self._window: SlideWindow | None = None

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the speed from a scan on, or from the next scan if that one is past.

        A change of sign means that the skin has reversed; 0 means unknown.
        """
        self._gate.set_speed(speed_mm_s, from_index)

    def expect_late_fit(self, due_index: int) -> None:
        """Treat the fit that is due at a scan as not ready, as it was in the live run."""
        self._told_late.add(due_index)

    def take_late_fits(self) -> list[int]:
        """Return the due scans of the fits that were not ready since the last call."""
        late, self._late = self._late, []
        return late

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Return the events that an item completes.

        Parameters
        ----------
        item : ScanBlock or Gap
            A gap discards the window and its fits; the estimator then waits for the next slip.
        slip : sequence of Event
            Events of the slip detector for the same item; other topics are ignored.
        """
        if isinstance(item, Gap):
            self._gate.close()
            self._pending.clear()
            self._end_slip()
            return []
        events: list[Event] = []
        for piece in self._gate.pass_through(item, slip):
            if isinstance(piece, SlidingScans):
                if piece.are_past:
                    self._fill(piece.block, piece.speeds_mm_s)
                else:
                    events += self._answer_before(int(piece.block.index[0]), item)
                    events += self._gather(piece.block, piece.speeds_mm_s)
                continue
            if isinstance(piece, SlipStart):
                events += self._answer_before(piece.index, item)
            if isinstance(piece, SlipEnd):
                events += self._answer(item[: int(np.searchsorted(item.time_s, piece.time_s)) + 1])
                window = self._window or SlideWindow(0, 0, 0)
                window.end = piece
                events += self._refusal(window, piece.time_s)
            self._end_slip()
        return events + self._answer(item)

    def _gather(self, block: ScanBlock, speeds: FloatArray) -> list[Event]:
        """Fill the window up to each hop, answer what is due there, and hand over the next fit."""
        events: list[Event] = []
        n_hop = self._n_scans(self._params.hop_s, block.rate_hz)
        n_window = self._n_scans(self._params.criteria.max_window_s, block.rate_hz)
        done = 0
        while done < len(block):
            sign = np.sign(speeds[done])
            window = self._window
            if window is None or sign != window.scans.sign:
                events += self._answer_before(int(block.index[done]), block)
                window = self._begin_window(n_window, float(sign))
            changes = np.flatnonzero(np.sign(speeds[done:]) != sign)
            n = min(n_hop - window.n_scans % n_hop, len(block) - done, *changes[:1].tolist())
            part = block[done : done + n]
            window.append(part, speeds[done : done + n], self._full_scale_volts)
            done += n
            if window.n_scans % n_hop == 0:
                events += self._answer(part)
                if not window.is_over:
                    self._hand_over(window, part[-1:], n_hop)
                    events += self._answer(part)  # where nothing is to be waited for
                if window.is_over:
                    self._window = None
        return events

    def _begin_window(self, n_scans: int, sign: float) -> SlideWindow:
        self._window = SlideWindow(n_scans, len(self._layout.kind), self._widest * n_scans)
        self._slip_speed_sign = self._slip_speed_sign or sign
        return self._window

    def _fill(self, block: ScanBlock, speeds: FloatArray) -> None:
        """Begin the window with scans that came before the slip was detected; nothing is answered of them."""
        n_window = self._n_scans(self._params.criteria.max_window_s, block.rate_hz)
        window = self._window or self._begin_window(n_window, float(np.sign(speeds[0])))
        window.append(block, speeds, self._full_scale_volts)

    def _n_scans(self, duration_s: float, rate_hz: float) -> int:
        return max(1, round(duration_s * rate_hz))

    def _hand_over(self, window: SlideWindow, newest: ScanBlock, n_hop: int) -> None:
        """Hand a copy of the window to the worker, to track the wave of the last answer or to fit anew."""
        scans, time_s = window.scans, float(newest.time_s[-1])
        last = window.last if window.has_answer and window.n_scans < window.n_next_fit else None
        if not isinstance(last, GrooveAnswer) or last.wave is None:
            last, window.n_next_fit = None, window.n_scans + len(scans)
        given = scans.for_fit(newest.channel_offset_s, self._layout, self._motion(scans), self._params)
        work = partial(_track_or_fit, self._fit, last, given)
        is_full = window.n_scans >= scans.size
        n_hops_full = -(-scans.size // n_hop)
        window.n_pending += 1
        self._pending.append(
            PendingFit(
                job=InPlace().submit(_stale) if newest.late[-1] else self._worker.submit(work),
                due_index=int(newest.index[-1]) + round(self._params.answer_after_s * newest.rate_hz),
                window=window,
                span=window.span(time_s, newest.rate_hz),
                is_full=is_full,
                is_refusal_due=is_full and window.n_scans // n_hop % n_hops_full == 0,
            )
        )

    def _answer_before(self, index: int, block: ScanBlock) -> list[Event]:
        """Report the fits that are due at the scans of a block before one of them, at which a window begins.

        Otherwise they would be reported at the first scans of that window, but not where scans come singly.
        """
        n_before = index - int(block.index[0])
        return self._answer(block[:n_before]) if n_before else []

    def _answer(self, block: ScanBlock) -> list[Event]:
        """Report the fits that are due at the scans of a block."""
        events: list[Event] = []
        while self._pending and self._pending[0].due_index <= block.index[-1]:
            pending = self._pending.popleft()
            window = pending.window
            window.n_pending -= 1
            answered_s = float(block.time_s[np.searchsorted(block.index, pending.due_index)])
            fit = pending.job.result()
            if fit is None or pending.due_index in self._told_late:
                self._told_late.discard(pending.due_index)
                self._late.append(pending.due_index)
                fit = _stale()
            if isinstance(fit, GrooveAnswer) and fit.period_sd_mm > _LARGEST_SD_PART * fit.period_mm:
                fit = Refusal("too-few-periods")
            if pending.is_reported(fit, self._params.criteria):
                window.has_answer = not isinstance(fit, Refusal)
                events.append(self._event(pending.span, fit, answered_s))
            window.last = fit
            if fit.status == "too-few-periods" and pending.is_full:
                window.scans.widen()
            if isinstance(fit, NewPattern):
                window.is_over, window.n_pending = True, 0
                self._pending = deque(other for other in self._pending if other.window is not window)
            events += self._refusal(window, answered_s)
        return events

    def _refusal(self, window: SlideWindow, answered_s: float) -> list[Event]:
        """Report why a slip that has ended, and whose fits are all in, had no answer."""
        end = window.end
        if end is None or window.n_pending or window.has_answer:
            return []
        last = window.last
        if isinstance(last, PeriodOnly):  # of one window alone
            last = Refusal("too-few-periods")
        return [self._event(window.span(end.time_s, end.rate_hz), last, answered_s)]

    def _event(self, span: FitSpan, fit: Outcome, answered_s: float) -> TextureEvent:
        return texture_event(span, fit, answered_s, self._params.speed_sd_mm_s)

    def _motion(self, scans: ScanWindow) -> WaveMotion:
        slip = self._gate.slip
        assert slip is not None
        direction_deg = slip.direction_deg
        direction_sd_deg = float(np.hypot(slip.direction_sd_deg, _GROOVES_TURN_DEG))
        forward = self._slip_speed_sign
        if self._params.direction_deg is not None:
            direction_deg, direction_sd_deg = self._params.direction_deg, 0.0
            forward = 1.0
        if scans.sign * forward < 0:
            direction_deg += 180.0
        return WaveMotion(scans.speed_mm_s, self._params.speed_sd_mm_s, direction_deg, direction_sd_deg)


def _track_or_fit(fit: WindowFit, last: GrooveAnswer | None, window: FitWindow) -> Outcome:
    """Track the wave of an answer; fit the window where there is none or where it is lost."""
    tracked = None if last is None else track_wave(last, window)
    return fit(window) if tracked is None else tracked


def _stale() -> Outcome:
    return Refusal("stale")
