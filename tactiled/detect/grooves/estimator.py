"""Online groove estimator by the joint fit ("joint"): an early answer that later fits refine.

`fit` holds the fit of one window and `track` follows its wave to the next; this module manages the window.

docs/grooves.md says when a window begins, when it is tracked or fitted anew, and when the first answer comes.
A fit costs some thirty times as much as tracking, and until there is an answer, each hop has one.
What it does not say:

* A new window begins also where the speed changes sign, becomes known or becomes unknown. Hops are counted in
  scans, so the arithmetic does not depend on how scans were chunked.
* The answer of a fit is reported at a fixed scan; a fit that is not ready by then is reported as "stale".
* A refusal comes when an answer is lost, when the window is full and after every further full length, and at
  the end of a slip that had no answer.
* A period without an angle (`period_only`) is reported where the window before had the same line, and not a
  refusal; windows with too few periods are passed over.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
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
from tactiled.detect.grooves.params import AnswerCriteria, JointParams
from tactiled.detect.grooves.window import FitWindow
from tactiled.detect.grooves.window_fits import fit_wave, track_wave
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.slip_gate import SlidingScans, SlipEnd, SlipGate, SlipStart
from tactiled.detect.worker import InPlace, Job, Worker
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock

# derived: of the period. Two gratings that differ by less could not be told apart at two standard deviations.
_LARGEST_SD_PART = 0.25
# physical: grooves deflect friction, and with it the direction of the slip event: by up to 5 degrees on
# physical scenes.
_GROOVES_TURN_DEG = 3.0
# derived: periods in the window by which the line of the window before may differ. Chance lines come at any
# place.
_REPEATED_LINE_PERIODS = 0.5

WindowFit = Callable[[FitWindow], Outcome]
_Scans = tuple[FloatArray, NDArray[np.bool_], FloatArray, FloatArray]


class SlideWindow:
    """The newest scans of one slip in one direction, and the newest results of their fits.

    Parameters
    ----------
    size : int
        Scans of a full window.
    most : int
        Scans that a widened window may have.
    """

    def __init__(self, size: int, most: int) -> None:
        self.size = size
        self._most = max(size, most)
        self._pieces: list[_Scans] = []  # readings, which are usable, instants, speeds
        self.n_scans = 0  # since the window began
        self.n_next_fit = 0
        self.is_over = False
        self.newest_is_answer = False  # of what was reported
        self.last: Outcome = Refusal("no-slip")
        self.tracked: GrooveAnswer | None = None  # the answer whose wave the next fit may track
        self.line_hz = 0.0  # of the newest fit that tells; 0 unless it was a period without an angle

    def append(self, block: ScanBlock, speeds_mm_s: FloatArray, full_scale_volts: float) -> None:
        """Append scans and the speed at each; readings beyond the converter's range are not used."""
        good = block.valid & (np.abs(block.volts) <= full_scale_volts)
        self._pieces.append((block.volts, good, block.time_s, speeds_mm_s))
        self.n_scans += len(block)

    def widen(self) -> None:
        """Double the number of scans, up to the most."""
        self.size = min(2 * self.size, self._most)

    def scans(self) -> _Scans:
        """Return the scans in the window: arrays that nothing changes, so a fit may run beside the loop."""
        volts, good, time_s, speeds_mm_s = (
            np.concatenate(parts)[-self._most :] for parts in zip(*self._pieces, strict=True)
        )
        self._pieces = [(volts, good, time_s, speeds_mm_s)]
        newest = slice(-self.size, None)
        return volts[newest], good[newest], time_s[newest], speeds_mm_s[newest]

    def __len__(self) -> int:
        return min(self.n_scans, self.size)

    @property
    def sign(self) -> float:
        """Sign of the newest speed: 1 forward, -1 backward, 0 unknown."""
        return float(np.sign(self._pieces[-1][-1][-1]))

    def span(self, end_s: float, rate_hz: float) -> FitSpan:
        """Describe the scans in the window, with the mean of the speeds that were set, without a sign."""
        speed_mm_s = float(np.abs(self.scans()[-1]).mean()) if self._pieces else 0.0
        return FitSpan(end_s, len(self) / rate_hz, speed_mm_s)


@dataclass(eq=False)
class Slip:
    """A slip, whose windows follow one another."""

    window: SlideWindow | None = None
    speed_sign: float = 0.0  # of the first speed that was known
    had_answer: bool = False
    end: SlipEnd | None = None


@dataclass(frozen=True, eq=False)
class PendingFit:
    """A fit that was handed over."""

    job: Job[Outcome]
    due_index: int  # scan at which the answer is reported
    slip: Slip
    window: SlideWindow
    tracked: GrooveAnswer | None  # None where the window is fitted anew
    span: FitSpan
    is_full: bool  # True where the window had its full length
    is_refusal_due: bool  # True where a refusal is reported also without an answer before it

    def is_reported(self, fit: Outcome, criteria: AnswerCriteria) -> bool:
        """Return True for an answer that is good enough, and for a refusal that is due."""
        if isinstance(fit, PeriodOnly):
            moved_hz = abs(fit.frequency_hz - self.window.line_hz)
            return moved_hz * self.span.window_s < _REPEATED_LINE_PERIODS
        if isinstance(fit, Refusal):
            return self.window.newest_is_answer or self.is_refusal_due
        is_good = (
            fit.period_sd_mm <= criteria.period_sd_mm
            and fit.angle_sd_deg <= criteria.angle_sd_deg
            and fit.frequency_hz * self.span.window_s >= criteria.answer_periods
        )
        return is_good or self.is_full or self.window.newest_is_answer


class JointTexture:
    """Report texture events by the joint fit.

    Parameters
    ----------
    worker : Worker, optional
        Computes the fits; by default they are computed in place.
    looks_back_s : float
        See `SlipGate`.
    widest : int
        How many times its full length a window may have, while it holds too few periods.
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
        self._slip = Slip()

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the speed from a scan on, or from the next one: negative backwards, 0 unknown."""
        self._gate.set_speed(speed_mm_s, from_index)

    def expect_late_fit(self, due_index: int) -> None:
        """Treat the fit that is due at a scan as not ready, as it was in the live run."""
        self._told_late.add(due_index)

    def take_late_fits(self) -> list[int]:
        """Return the due scans of the fits that were not ready since the last call."""
        late, self._late = self._late, []
        return late

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Return the events that an item completes, given the events of the slip detector for it.

        A gap discards the window and its fits; the estimator then waits for the next slip.
        """
        if isinstance(item, Gap):
            self._gate.close()
            self._pending.clear()
            self._slip = Slip()
            return []
        events: list[Event] = []
        for piece in self._gate.pass_through(item, slip):
            if isinstance(piece, SlidingScans):
                if not piece.are_past:
                    events += self._answer_before(int(piece.block.index[0]), item)
                events += self._gather(piece)
                continue
            if isinstance(piece, SlipStart):
                events += self._answer_before(piece.index, item)
            if isinstance(piece, SlipEnd):
                events += self._answer(item[: int(np.searchsorted(item.time_s, piece.time_s)) + 1])
                self._slip.end = piece
                events += self._refusal(self._slip, piece.time_s)
            self._slip = Slip()
        return events + self._answer(item)

    def _gather(self, piece: SlidingScans) -> list[Event]:
        """Fill the window up to each hop, answer what is due there, and hand over the next fit.

        Nothing is answered of scans that came before the slip was detected.
        """
        block, speeds = piece.block, piece.speeds_mm_s
        events: list[Event] = []
        n_hop, done = max(1, round(self._params.hop_s * block.rate_hz)), 0
        while done < len(block):
            sign = np.sign(speeds[done])
            window = self._slip.window
            if window is None or sign != window.sign:
                events += self._answer_before(int(block.index[done]), block)
                window = self._begin_window(block.rate_hz, float(sign))
            changes = np.flatnonzero(np.sign(speeds[done:]) != sign)
            n = min(n_hop - window.n_scans % n_hop, len(block) - done, *changes[:1].tolist())
            part = block[done : done + n]
            window.append(part, speeds[done : done + n], self._full_scale_volts)
            done += n
            if window.n_scans % n_hop == 0 and not piece.are_past:
                events += self._answer(part)
                if not window.is_over:
                    self._hand_over(window, part[-1:], n_hop)
                    events += self._answer(part)  # where nothing is to be waited for
                if window.is_over:
                    self._slip.window = None
        return events

    def _begin_window(self, rate_hz: float, sign: float) -> SlideWindow:
        n_scans = max(1, round(self._params.criteria.max_window_s * rate_hz))
        self._slip.window = SlideWindow(n_scans, self._widest * n_scans)
        self._slip.speed_sign = self._slip.speed_sign or sign
        return self._slip.window

    def _hand_over(self, window: SlideWindow, newest: ScanBlock, n_hop: int) -> None:
        """Hand the window to the worker, to track the wave of the last answer or to fit anew."""
        volts, good, time_s, speeds_mm_s = window.scans()
        span = window.span(float(newest.time_s[-1]), newest.rate_hz)
        tracked = window.tracked if window.n_scans < window.n_next_fit else None
        if tracked is None or tracked.wave is None:
            tracked, window.n_next_fit = None, window.n_scans + len(window)
        motion = self._motion(window.sign, span.given_speed_mm_s)
        given = FitWindow(
            volts,
            time_s,
            newest.channel_offset_s,
            self._layout,
            motion,
            self._params,
            good,
            np.abs(speeds_mm_s),
        )
        is_full = window.n_scans >= window.size
        work = partial(_track_or_fit, self._fit, tracked, given, is_full=is_full)
        n_hops_full = -(-window.size // n_hop)
        self._pending.append(
            PendingFit(
                job=InPlace().submit(_stale) if newest.late[-1] else self._worker.submit(work),
                due_index=int(newest.index[-1]) + round(self._params.answer_after_s * newest.rate_hz),
                slip=self._slip,
                window=window,
                tracked=tracked,
                span=span,
                is_full=is_full,
                is_refusal_due=is_full and window.n_scans // n_hop % n_hops_full == 0,
            )
        )

    def _answer_before(self, index: int, block: ScanBlock) -> list[Event]:
        """Report the fits that are due at the scans of a block before one of them, at which a window begins.

        Otherwise they would be reported of that window, but not where scans come singly.
        """
        n_before = index - int(block.index[0])
        return self._answer(block[:n_before]) if n_before else []

    def _answer(self, block: ScanBlock) -> list[Event]:
        """Report the fits that are due at the scans of a block."""
        events: list[Event] = []
        while self._pending and self._pending[0].due_index <= block.index[-1]:
            pending = self._pending.popleft()
            slip, window = pending.slip, pending.window
            answered_s = float(block.time_s[np.searchsorted(block.index, pending.due_index)])
            fit = pending.job.result()
            if fit is None or pending.due_index in self._told_late:
                self._told_late.discard(pending.due_index)
                self._late.append(pending.due_index)
                fit = _stale()
            if isinstance(fit, GrooveAnswer) and fit.period_sd_mm > _LARGEST_SD_PART * fit.period_mm:
                fit = Refusal("too-few-periods")
            if pending.is_reported(fit, self._params.criteria):
                window.newest_is_answer = not isinstance(fit, Refusal)
                slip.had_answer |= window.newest_is_answer
                events.append(self._event(pending.span, fit, answered_s))
            window.last = fit
            if fit.status == "stale":  # nothing is known of this window, so the wave may still be tracked
                window.tracked = pending.tracked
            else:
                window.tracked = fit if isinstance(fit, GrooveAnswer) and window.newest_is_answer else None
                if fit.status != "too-few-periods":  # such a window is too short to say anything of the line
                    window.line_hz = fit.frequency_hz if isinstance(fit, PeriodOnly) else 0.0
            if fit.status == "too-few-periods" and pending.is_full:
                window.widen()
            if isinstance(fit, NewPattern):
                window.is_over = True
                self._pending = deque(other for other in self._pending if other.window is not window)
            events += self._refusal(slip, answered_s)
        return events

    def _refusal(self, slip: Slip, answered_s: float) -> list[Event]:
        """Report why a slip that has ended, and whose fits are all in, had no answer."""
        end, window = slip.end, SlideWindow(0, 0) if slip.window is None else slip.window
        if end is None or slip.had_answer or any(other.slip is slip for other in self._pending):
            return []
        last = window.last
        if isinstance(last, PeriodOnly):  # of one window alone
            last = Refusal("too-few-periods")
        return [self._event(window.span(end.time_s, end.rate_hz), last, answered_s)]

    def _event(self, span: FitSpan, fit: Outcome, answered_s: float) -> TextureEvent:
        return texture_event(span, fit, answered_s, self._params.speed_sd_mm_s)

    def _motion(self, sign: float, speed_mm_s: float) -> WaveMotion:
        slip = self._gate.slip
        assert slip is not None
        direction_deg = slip.direction_deg
        direction_sd_deg = float(np.hypot(slip.direction_sd_deg, _GROOVES_TURN_DEG))
        forward = self._slip.speed_sign
        if self._params.direction_deg is not None:
            direction_deg, direction_sd_deg = self._params.direction_deg, 0.0
            forward = 1.0
        if sign * forward < 0:
            direction_deg += 180.0
        return WaveMotion(speed_mm_s, self._params.speed_sd_mm_s, direction_deg, direction_sd_deg)


def _track_or_fit(fit: WindowFit, last: GrooveAnswer | None, window: FitWindow, *, is_full: bool) -> Outcome:
    """Track the wave of an answer; fit the window where there is none or where it is lost."""
    outcome = None if last is None else track_wave(last, window, is_full=is_full)
    return fit(window) if outcome is None else outcome


def _stale() -> Outcome:
    return Refusal("stale")
