"""The published procedure for grooved surfaces, online; `grooves` has the equations.

Flow chart of Wang, Chen, Mei 2019: wait for slip; sample three taxels of a column for 10 s; estimate; if the
two periods disagree, sample again; otherwise output their mean, and continue while slip lasts. Added here:

* Windows begin a second after the scan that detected slip, so that they do not contain the onset, and
  follow one another without overlap. They are counted in scans, so chunking does not matter.
* The signal of a taxel is one resistor, as in the paper's plots: the one (R1 in all three taxels, say) with
  the largest peak. The mean of four would suit pressure, but ripples of opposed resistors cancel in it.
* The speed is given. Without it (0) the procedure cannot answer: "no-slip", since a skin that is not known to
  move does not slide. A speed that changes within a window starts a new one.
* The direction is that of the slip event, unless configured. Towards the column (beyond 60 degrees from x),
  or where the direction is unknown, delays do not determine the angle: "ambiguous". The same holds for an
  array without a column.
* A slip that ends before any window was full is "no-slip". A window whose last scan came late is "stale". A
  window in which each resistor has a bad reading in some taxel is "saturated".
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.slip_gate import SlidingScans, SlipEnd, SlipGate
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.wang2019 import grooves
from tactiled.wang2019.grooves import GrooveEstimate, GrooveLimits, SlidingMotion
from tactiled.wang2019.spectrum import Spectrum, spectrum

ESTIMATOR = "wang2019"
_SETTLE_S = 1.0  # choice
_MIN_WINDOW_SCANS = 8  # derived: a spectrum of fewer has no peaks


class PaperTexture:
    """Report texture events by the published procedure.

    The speed, 0 where it is not known, holds until another is set. The direction of the skin's motion is by
    default that of the slip event. With `is_given`, sliding is known from outside: there is no onset that a
    window must not contain.

    Examples
    --------
    Grooves of 1.2 mm inclined by 30 degrees under a slip along +x that is detected at the first scan:

    >>> import numpy as np
    >>> from tactiled.array import load_array
    >>> from tactiled.events.types import SlipEvent
    >>> from tactiled.samples.block import regular_block
    >>> array, rng, angle = load_array("wang2019-3x3"), np.random.default_rng(0), np.radians(30)
    >>> x_mm = array.x_mm[array.channel_taxel] + 1.0 * np.arange(1200)[:, np.newaxis] / 100
    >>> y_mm = array.y_mm[array.channel_taxel]
    >>> phase = 2 * np.pi / 1.2 * (x_mm * np.cos(angle) + y_mm * np.sin(angle)) + np.arange(36) % 4
    >>> volts = 1 + 0.05 * np.cos(phase) + 0.005 * rng.standard_normal(phase.shape)
    >>> slip = SlipEvent(
    ...     time_s=0.0, state="onset", kind="gross", onset_s=0.0, onset_sd_s=0.01,
    ...     direction_deg=0.0, direction_sd_deg=1.0, confidence=1.0, taxels=(), detector="wang2019",
    ...     statistic=1.0, threshold=0.0, valid=True, detected_s=0.0,
    ... )
    >>> texture = PaperTexture(array, speed_mm_s=1.0)
    >>> for event in texture.process(regular_block(volts, 100.0), [slip]):
    ...     print(f"{event.time_s:.2f} s: {event.period_mm:.2f} mm, {event.angle_deg:.1f} degrees")
    10.99 s: 1.24 mm, 29.4 degrees
    """

    def __init__(
        self,
        array: Array,
        speed_mm_s: float = 0.0,
        speed_sd_mm_s: float = 0.0,
        direction_deg: float | None = None,
        is_given: bool = False,
        limits: GrooveLimits | None = None,
    ) -> None:
        self._n_channels = array.n_channels
        self._given_mm_s, self._speed_sd_mm_s, self._direction_deg = speed_mm_s, speed_sd_mm_s, direction_deg
        self._settle_s = 0.0 if is_given else _SETTLE_S
        self._limits = limits or GrooveLimits()
        columns = array.columns()
        taxels = columns[0][:3] if columns else []
        self._y_mm, self._resistors = array.y_mm[taxels], _resistors(array, taxels)
        self._grid = Quantiser(array)
        self.reset()

    def reset(self) -> None:
        """Discard all scans and the speeds set since construction."""
        self._gate = SlipGate(self._settle_s, self._given_mm_s)
        self._speed_mm_s = self._given_mm_s
        self._stop()

    def _stop(self) -> None:
        self._answered = False
        self._n_gathered = 0

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the speed from a scan on, or from the next scan if that one is past."""
        self._gate.set_speed(speed_mm_s, from_index)

    def expect_late_fit(self, due_index: int) -> None:
        """Do nothing: every fit is computed in place."""

    def take_late_fits(self) -> list[int]:
        """Return no scans: every fit is computed in place."""
        return []

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Return the events that an item completes, given the events of the slip detector for it.

        A gap discards the window; the procedure then waits for the next slip.
        """
        if isinstance(item, Gap):
            self._gate.close()
            self._stop()
            return []
        events: list[Event] = []
        for piece in self._gate.pass_through(item, slip):
            if isinstance(piece, SlidingScans):
                events += self._gather(piece.block, piece.speeds_mm_s)
                continue
            if isinstance(piece, SlipEnd) and not self._answered:
                self._speed_mm_s = self._gate.speed_mm_s
                window_s = self._n_gathered / piece.rate_hz
                events.append(self._event(piece.time_s, window_s, GrooveEstimate("no-slip")))
            self._stop()
        return events

    def _gather(self, block: ScanBlock, speeds_mm_s: FloatArray) -> list[Event]:
        """Fill windows; a change of speed begins a new one."""
        events: list[Event] = []
        n_window = max(_MIN_WINDOW_SCANS, round(self._limits.window_s * block.rate_hz))
        ends = [*(np.flatnonzero(np.diff(speeds_mm_s)) + 1).tolist(), len(block)]
        done = 0
        while done < len(block):
            if speeds_mm_s[done] != self._speed_mm_s:
                self._speed_mm_s, self._n_gathered = float(speeds_mm_s[done]), 0
            if self._n_gathered == 0:
                self._volts = np.empty((n_window, self._n_channels))
                self._good = np.ones(self._n_channels, dtype=np.bool_)
            ends = [end for end in ends if end > done]
            part = block[done : min(done + n_window - self._n_gathered, ends[0])]
            self._volts[self._n_gathered : self._n_gathered + len(part)] = part.volts
            in_scale = np.abs(part.volts) <= self._grid.full_scale_volts  # no NaN is
            self._good &= (part.valid & in_scale).all(axis=0)
            self._n_gathered += len(part)
            done += len(part)
            if self._n_gathered == n_window:
                # only the last scan counts: an earlier backlog is over, and its readings are good
                found = GrooveEstimate("stale") if part.late[-1] else self._estimate(block)
                events.append(self._event(float(part.time_s[-1]), n_window / block.rate_hz, found))
                self._answered, self._n_gathered = True, 0
        return events

    def _estimate(self, block: ScanBlock) -> GrooveEstimate:
        """Estimate the grooves of a full window, whose last scans are those of a block."""
        slip = self._gate.slip
        if self._speed_mm_s <= 0 or slip is None:
            return GrooveEstimate("no-slip")
        if not self._resistors:
            return GrooveEstimate("ambiguous")
        usable = [channels for channels in self._resistors if self._good[channels].all()]
        if not usable:
            return GrooveEstimate("saturated")
        step, low_pass_hz = self._grid.volts_per_step, self._limits.low_pass_hz
        channels = max(
            usable, key=lambda own: _strength(spectrum(self._volts[:, own], block.rate_hz, step, low_pass_hz))
        )
        direction_deg, direction_sd_deg = slip.direction_deg, slip.direction_sd_deg
        if self._direction_deg is not None:
            direction_deg, direction_sd_deg = self._direction_deg, 0.0
        return grooves.estimate(
            self._volts[:, channels],
            block.rate_hz,
            step,
            self._y_mm,
            block.channel_offset_s[channels],
            SlidingMotion(self._speed_mm_s, self._speed_sd_mm_s, direction_deg, direction_sd_deg),
            self._limits,
        )

    def _event(self, time_s: float, window_s: float, found: GrooveEstimate) -> TextureEvent:
        is_known = self._speed_mm_s > 0
        return TextureEvent(
            time_s=time_s,
            answered_s=time_s,
            speed_mm_s=self._speed_mm_s,
            speed_sd_mm_s=self._speed_sd_mm_s if is_known else 0.0,
            speed_source="given" if is_known else "none",
            window_s=window_s,
            estimator=ESTIMATOR,
            **vars(found),
        )


def _strength(seen: Spectrum) -> tuple[bool, float]:
    """Sort key: a ripple, inside the band or beyond it, ranks above a trend or noise."""
    return seen.status in ("ok", "aliased"), float((seen.amplitude_volts[seen.peak] ** 2).sum())


def _resistors(array: Array, taxels: list[int]) -> list[NDArray[np.int64]]:
    """Channels of equal kind and azimuth that are present in all taxels: all R1, all R2, ..."""
    kinds = list(zip(array.channel_kind, np.nan_to_num(array.azimuth_deg).tolist(), strict=True))
    own = [{kinds[c]: c for c in np.flatnonzero(array.channel_taxel == taxel)} for taxel in taxels]
    shared = [kind for kind in (own[0] if own else ()) if all(kind in one for one in own)]
    return [np.array([one[kind] for one in own]) for kind in shared]
