"""State of the joint estimator for one slide: its scans, and the fits that were handed over."""

from dataclasses import dataclass

import numpy as np

from tactiled.array import FloatArray
from tactiled.detect.grooves.outcome import Outcome, PeriodOnly, Refusal
from tactiled.detect.grooves.params import AnswerCriteria
from tactiled.detect.grooves.texture import FitSpan
from tactiled.detect.grooves.window import ScanWindow
from tactiled.detect.signal.slip_gate import SlipEnd
from tactiled.detect.worker import Job
from tactiled.samples.block import ScanBlock

# derived: in the window: a line at the place of the newest one before it. Chance lines come at any place.
_SAME_LINE_PERIODS = 0.5


class SlideWindow:
    """Scans of one slip in one direction, and what was answered of them."""

    def __init__(self, n_scans: int, n_channels: int, most: int) -> None:
        self.scans = ScanWindow(n_scans, n_channels, most)
        self.n_scans = 0
        self.n_next_fit = 0
        self.n_pending = 0
        self.has_answer = False
        self.is_over = False
        self.last: Outcome = Refusal("no-slip")
        self.line_hz = 0.0
        self.end: SlipEnd | None = None

    def append(self, block: ScanBlock, speeds_mm_s: FloatArray, full_scale_volts: float) -> None:
        """Append scans; readings beyond the converter's range are not used."""
        good = block.valid & (np.abs(block.volts) <= full_scale_volts)
        self.scans.append(block, good, speeds_mm_s)
        self.n_scans += len(block)

    def span(self, end_s: float, rate_hz: float) -> FitSpan:
        """Describe the scans in the window."""
        return FitSpan(end_s, len(self.scans) / rate_hz, self.scans.speed_mm_s)


@dataclass(frozen=True, eq=False)
class PendingFit:
    """A fit that was handed over.

    Attributes
    ----------
    due_index : int
        Scan at which the answer is reported.
    is_refusal_due : bool
        True where a refusal is reported also without an answer before it.
    is_full : bool
        True where the window had its full length.
    """

    job: Job[Outcome]
    due_index: int
    window: SlideWindow
    span: FitSpan
    is_full: bool
    is_refusal_due: bool

    def is_reported(self, fit: Outcome, criteria: AnswerCriteria) -> bool:
        """Return True for an answer that is good enough, and for a refusal that is due."""
        if isinstance(fit, PeriodOnly):
            before_hz, self.window.line_hz = self.window.line_hz, fit.frequency_hz
            return abs(fit.frequency_hz - before_hz) * self.span.window_s < _SAME_LINE_PERIODS
        if isinstance(fit, Refusal):
            return self.window.has_answer or self.is_refusal_due
        is_good = (
            fit.period_sd_mm <= criteria.period_sd_mm
            and fit.angle_sd_deg <= criteria.angle_sd_deg
            and fit.frequency_hz * self.span.window_s >= criteria.answer_periods
        )
        return is_good or self.is_full or self.window.has_answer
