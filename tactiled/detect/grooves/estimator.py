"""Online groove estimator by the joint fit ("joint"): an early answer that later fits refine.

`fit` holds the fit of one window; this module manages the window.

* A window begins `settle_s` after the scan that detected slip, grows to `max_window_s`, then slides. It is
  fitted every `hop_s`, counted in scans, so the arithmetic does not depend on how scans were chunked.
* The first answer comes when the number of periods and both standard deviations meet the criteria, or when
  the window has its full length; then one follows at every hop. A refusal comes when an answer is lost, when
  the window is full and after every further full length, and at the end of a slip that had no answer.
* A given speed ties the frequency to the wave vector, and windows are measured in distance travelled, so that
  a varying speed does not smear the line. Without one (0) the speed is estimated. A new window begins where
  the speed changes sign, becomes known or becomes unknown.
* The direction is that of the slip event, unless configured. Where neither is known, no speed is estimated.
* With two gratings in view the event describes the stronger one, and `candidates` of an "ok" event lists
  both, weighted by their shares of the ripple's power.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.model import WaveFit, WaveMotion, WaveParams, channel_layout
from tactiled.detect.grooves.window import ScanWindow
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.slip_gate import SlidingScans, SlipEnd, SlipGate
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock

ESTIMATOR = "joint"
Preset = Literal["quick", "balanced", "fine"]


class AnswerCriteria(NamedTuple):
    """Precision and window that an answer must have."""

    period_sd_mm: float
    angle_sd_deg: float
    max_window_s: float
    answer_periods: float


# At 20 dB and 1.5 mm/s the standard deviations are 1 um and 0.04 degrees as soon as there is an answer
# (`./run bench texture`): the number of periods decides when it comes, the standard deviations where the
# signal is weak. "quick" takes the minimum; from 1.25 periods on errors reach the bound; from 2.5 on drift
# may be a curve.
PRESETS: dict[Preset, AnswerCriteria] = {
    "quick": AnswerCriteria(0.02, 1.0, 3.0, 0.8),
    "balanced": AnswerCriteria(0.005, 0.25, 8.0, 1.25),
    "fine": AnswerCriteria(0.001, 0.05, 20.0, 2.5),
}

# Grooves deflect friction, and with it the direction of the slip event: by up to 5 degrees on physical
# scenes.
_GROOVES_TURN_DEG = 3.0


class JointParams(WaveParams):
    """Parameters of the joint estimator."""

    preset: Preset = Field(default="balanced", description="defaults of the next four")
    period_sd_mm: float | None = Field(
        default=None, gt=0, description="standard deviation of the period that an answer needs"
    )
    angle_sd_deg: float | None = Field(
        default=None, gt=0, description="standard deviation of the angle that an answer needs"
    )
    max_window_s: float | None = Field(
        default=None, gt=0, le=120, description="longest window; answer then in any case"
    )
    answer_periods: float | None = Field(
        default=None, gt=0, le=50, description="ripple periods in the window that an earlier answer needs"
    )
    hop_s: float = Field(default=0.2, ge=0.02, le=10, description="interval between fits")
    settle_s: float = Field(default=0.3, ge=0, le=60, description="time from detected slip to the window")
    speed_mm_s: float = Field(default=0.0, ge=0, description="sliding speed; 0: unknown, to be estimated")
    speed_sd_mm_s: float = Field(default=0.0, ge=0, description="standard deviation of the speed")
    direction_deg: float | None = Field(
        default=None,
        ge=-180,
        le=180,
        description="direction of the skin's motion, +x towards +y; left out: from the slip event",
    )

    @property
    def criteria(self) -> AnswerCriteria:
        """Criteria given explicitly, completed by those of the preset."""
        given = {name: getattr(self, name) for name in AnswerCriteria._fields}
        return PRESETS[self.preset]._replace(**{name: x for name, x in given.items() if x is not None})


class JointTexture:
    """Report texture events by the joint fit.

    Parameters
    ----------
    array : Array
    params : JointParams

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
    ...     direction_deg=0.0, direction_sd_deg=1.0, confidence=1.0, taxels=(), detector="coherent",
    ...     statistic=1.0, threshold=0.0, valid=True, detected_s=0.0,
    ... )
    >>> events = JointTexture(array, JointParams(speed_mm_s=2.0)).process(block, [slip])
    >>> for event in (events[0], events[-1]):
    ...     print(f"{event.time_s:.2f} s: {event.period_mm:.3f} mm, {event.angle_deg:.1f} degrees")
    1.09 s: 1.200 mm, 20.0 degrees
    1.89 s: 1.200 mm, 20.0 degrees
    """

    def __init__(self, array: Array, params: JointParams | None = None) -> None:
        self._layout = channel_layout(array)
        self._n_channels = array.n_channels
        self._full_scale_volts = Quantiser(array).full_scale_volts
        self._params = params or JointParams()
        self.reset()

    def reset(self) -> None:
        """Discard all scans and the speeds set since construction; keep the parameters."""
        self._gate = SlipGate(self._params.settle_s, self._params.speed_mm_s)
        self._end_slip()

    def _end_slip(self) -> None:
        self._slip_speed_sign = 0.0
        self._clear_window()

    def _clear_window(self) -> None:
        self._scans = ScanWindow(0, self._n_channels)
        self._n_scans = 0
        self._has_answer = False
        self._last = WaveFit("no-slip")

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the speed from a scan on, or from the next scan if that one is past.

        A change of sign means that the skin has reversed; 0 means unknown.
        """
        self._gate.set_speed(speed_mm_s, from_index)

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Return the events that an item completes.

        Parameters
        ----------
        item : ScanBlock or Gap
            A gap discards the window; the estimator then waits for the next slip.
        slip : sequence of Event
            Events of the slip detector for the same item; other topics are ignored.
        """
        if isinstance(item, Gap):
            self._gate.close()
            self._end_slip()
            return []
        events: list[Event] = []
        for piece in self._gate.pass_through(item, slip):
            if isinstance(piece, SlidingScans):
                events += self._gather(piece.block, piece.speeds_mm_s)
                continue
            if isinstance(piece, SlipEnd) and not self._has_answer:
                events.append(self._event(piece.time_s, len(self._scans) / piece.rate_hz, self._last))
            self._end_slip()
        return events

    def _gather(self, block: ScanBlock, speeds: FloatArray) -> list[Event]:
        """Fill the window up to each hop, and fit there."""
        events: list[Event] = []
        n_hop = self._n_hop(block.rate_hz)
        n_window = max(1, round(self._params.criteria.max_window_s * block.rate_hz))
        done = 0
        while done < len(block):
            sign = np.sign(speeds[done])
            if self._n_scans and sign != self._scans.sign:
                self._clear_window()
            if not self._n_scans:
                self._slip_speed_sign = self._slip_speed_sign or float(sign)
                self._scans = ScanWindow(n_window, self._n_channels)
            changes = np.flatnonzero(np.sign(speeds[done:]) != sign)
            n = min(n_hop - self._n_scans % n_hop, len(block) - done, *changes[:1].tolist())
            part = block[done : done + n]
            good = part.valid & (np.abs(part.volts) <= self._full_scale_volts)
            self._scans.append(part, good, speeds[done : done + n])
            self._n_scans += n
            done += n
            if self._n_scans % n_hop == 0:
                events += self._hop(part[-1:])
        return events

    def _n_hop(self, rate_hz: float) -> int:
        return max(1, round(self._params.hop_s * rate_hz))

    def _hop(self, newest: ScanBlock) -> list[Event]:
        """Fit the window and return the event due, if any."""
        criteria, scans = self._params.criteria, self._scans
        fit = self._fit(newest)
        is_good = (
            fit.status == "ok"
            and fit.period_sd_mm <= criteria.period_sd_mm
            and fit.angle_sd_deg <= criteria.angle_sd_deg
            and fit.frequency_hz * len(scans) / newest.rate_hz >= criteria.answer_periods
        )
        is_full = self._n_scans >= scans.size
        if fit.status == "ok":
            is_reported = is_good or is_full or self._has_answer
        else:
            n_hop = self._n_hop(newest.rate_hz)
            n_hops_full = -(-scans.size // n_hop)
            is_reported = self._has_answer or (is_full and self._n_scans // n_hop % n_hops_full == 0)
        self._has_answer = is_reported and fit.status == "ok"
        self._last = fit
        if not is_reported:
            return []
        return [self._event(float(newest.time_s[-1]), len(scans) / newest.rate_hz, fit)]

    def _fit(self, newest: ScanBlock) -> WaveFit:
        scans = self._scans
        if newest.late[-1]:
            return WaveFit("stale")
        return fit_wave(
            scans.volts,
            scans.time_s,
            newest.channel_offset_s,
            self._layout,
            self._motion(),
            self._params,
            scans.good,
            np.abs(scans.speeds_mm_s),
        )

    def _motion(self) -> WaveMotion:
        slip = self._gate.slip
        assert slip is not None
        direction_deg = slip.direction_deg
        direction_sd_deg = float(np.hypot(slip.direction_sd_deg, _GROOVES_TURN_DEG))
        forward = self._slip_speed_sign
        if self._params.direction_deg is not None:
            direction_deg, direction_sd_deg = self._params.direction_deg, 0.0
            forward = 1.0
        if self._scans.sign * forward < 0:
            direction_deg += 180.0
        speed_mm_s = float(np.abs(self._scans.speeds_mm_s).mean())
        return WaveMotion(speed_mm_s, self._params.speed_sd_mm_s, direction_deg, direction_sd_deg)

    def _event(self, time_s: float, window_s: float, fit: WaveFit) -> TextureEvent:
        is_given = self._scans.sign != 0 and (fit.uses_given_speed or fit.speed_mm_s == 0)
        speed_mm_s = float(np.abs(self._scans.speeds_mm_s).mean()) if is_given else fit.speed_mm_s
        return TextureEvent(
            time_s=time_s,
            status=fit.status,
            period_mm=fit.period_mm,
            period_sd_mm=fit.period_sd_mm,
            angle_deg=fit.angle_deg,
            angle_sd_deg=fit.angle_sd_deg,
            speed_mm_s=speed_mm_s,
            speed_sd_mm_s=self._params.speed_sd_mm_s if is_given else fit.speed_sd_mm_s,
            speed_source="given" if is_given else "estimated" if speed_mm_s > 0 else "none",
            frequency_hz=fit.frequency_hz,
            window_s=window_s,
            snr_db=fit.snr_db,
            candidates=fit.gratings if fit.second else fit.candidates,
            estimator=ESTIMATOR,
        )
