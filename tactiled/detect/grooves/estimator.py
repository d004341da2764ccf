"""Grooves online by the joint fit ("joint"): an answer as soon as it is good enough, refined after.

`wave_fit` has the estimator; this is the window around it. Ours are:

* A window begins `settle_s` after the scan that detected slip, grows to `max_window_s`, then slides along. It
  is fitted anew every `hop_s`, counted in scans: the arithmetic is the same however scans were chunked.
* The first answer comes when periods and both sigmas are what was asked for, or when the window has its full
  length; then one at every hop. A refusal comes when an answer is lost, when the window is full and at every
  full length after that, and at the end of a slip that had no answer.
* A speed that is given ties frequency to wave vector, and windows are measured in way travelled, so that a
  speed that changes does not smear. Without one (0) it is found from the fit. Where it turns round, or
  begins or ceases to be known, a new window begins.
* The direction is that of the slip event, unless configured; where neither knows, no speed is found.
* Two gratings in view: the event is about the stronger, and `candidates` of an "ok" event lists both, with
  their shares of the ripple's power for weights.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from tactiled.array import Array, FloatArray
from tactiled.detect.grooves.fit import fit_wave
from tactiled.detect.grooves.held import Held
from tactiled.detect.grooves.model import WaveFit, WaveMotion, WaveParams, layout_of
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.slip_gate import Ended, Gate, Slid
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock

ESTIMATOR = "joint"
Preset = Literal["quick", "balanced", "fine"]


class Asked(NamedTuple):
    """What an answer must have."""

    period_sd_mm: float
    angle_sd_deg: float
    max_window_s: float
    answer_periods: float


# At 20 dB and 1.5 mm/s, sigmas are 1 um and 0.04 degrees as soon as there is an answer (`./run bench
# texture`): periods decide when it comes, and sigmas where the signal is weak. "quick" takes the least; from
# 1.25 on sigmas are at the bound; from 2.5 on drift may be a curve.
PRESETS: dict[Preset, Asked] = {
    "quick": Asked(0.02, 1.0, 3.0, 0.8),
    "balanced": Asked(0.005, 0.25, 8.0, 1.25),
    "fine": Asked(0.001, 0.05, 20.0, 2.5),
}

# Grooves turn friction aside, and with it the direction that slip says: up to 5 degrees on physical scenes.
_GROOVES_TURN_DEG = 3.0


class JointParams(WaveParams):
    """The joint fit, online."""

    preset: Preset = Field(default="balanced", description="what the next four are where left out")
    period_sd_mm: float | None = Field(default=None, gt=0, description="answer at this sigma")
    angle_sd_deg: float | None = Field(default=None, gt=0, description="and this one")
    max_window_s: float | None = Field(default=None, gt=0, le=120, description="answer after this anyway")
    answer_periods: float | None = Field(
        default=None, gt=0, le=50, description="of the ripple in the window, for an answer before that"
    )
    hop_s: float = Field(default=0.2, ge=0.02, le=10, description="from one fit to the next")
    settle_s: float = Field(default=0.3, ge=0, le=60, description="from detected slip to the window")
    speed_mm_s: float = Field(default=0.0, ge=0, description="sliding speed; 0: not known, to be found")
    speed_sd_mm_s: float = Field(default=0.0, ge=0, description="its standard deviation")
    direction_deg: float | None = Field(
        default=None,
        ge=-180,
        le=180,
        description="of the skin's motion, from +x towards +y; left out: as slip says",
    )

    @property
    def asked(self) -> Asked:
        """What is given, and what the preset says of the rest."""
        given = {name: getattr(self, name) for name in Asked._fields}
        return PRESETS[self.preset]._replace(**{name: x for name, x in given.items() if x is not None})


class JointTexture:
    """Texture events by the joint fit.

    Parameters
    ----------
    array : Array
    params : JointParams
    """

    def __init__(self, array: Array, params: JointParams | None = None) -> None:
        self._layout = layout_of(array)
        self._n_channels = array.n_channels
        self._full_scale_volts = Quantiser(array).full_scale_volts
        self._params = params or JointParams()
        self.reset()

    def reset(self) -> None:
        """Forget everything seen, and every speed set since; keep the parameters."""
        self._gate = Gate(self._params.settle_s, self._params.speed_mm_s)
        self._stop()

    def _stop(self) -> None:
        self._slip_sign = 0.0
        self._clear()

    def _clear(self) -> None:
        self._held = Held(0, self._n_channels)
        self._n_seen = 0
        self._has_answer = False
        self._last = WaveFit("no-slip")

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Speed that holds from a scan on (or from the next scan to come, if that one is past).

        Where it changes its sign, the skin has turned back; 0 is not known.
        """
        self._gate.set_speed(speed_mm_s, from_index)

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Events that the item completes.

        Parameters
        ----------
        item : ScanBlock or Gap
            A gap discards the window, and waits for slip anew.
        slip : sequence of Event
            What the slip detector said of the same item; events of other topics are passed over.
        """
        if isinstance(item, Gap):
            self._gate.close()
            self._stop()
            return []
        events: list[Event] = []
        for piece in self._gate.pass_through(item, slip):
            if isinstance(piece, Slid):
                events += self._gather(piece.block, piece.speeds_mm_s)
                continue
            if isinstance(piece, Ended) and not self._has_answer:
                events.append(self._event(piece.time_s, len(self._held) / piece.rate_hz, self._last))
            self._stop()
        return events

    def _gather(self, block: ScanBlock, speeds: FloatArray) -> list[Event]:
        """Fill the window up to each hop, and fit there."""
        events: list[Event] = []
        n_hop = self._n_hop(block.rate_hz)
        n_window = max(1, round(self._params.asked.max_window_s * block.rate_hz))
        done = 0
        while done < len(block):
            sign = np.sign(speeds[done])
            if self._n_seen and sign != self._held.sign:
                self._clear()
            if not self._n_seen:
                self._slip_sign = self._slip_sign or float(sign)
                self._held = Held(n_window, self._n_channels)
            changes = np.flatnonzero(np.sign(speeds[done:]) != sign)
            n = min(n_hop - self._n_seen % n_hop, len(block) - done, *changes[:1].tolist())
            part = block[done : done + n]
            good = part.valid & (np.abs(part.volts) <= self._full_scale_volts)
            self._held.append(part, good, speeds[done : done + n])
            self._n_seen += n
            done += n
            if self._n_seen % n_hop == 0:
                events += self._hop(part[-1:])
        return events

    def _n_hop(self, rate_hz: float) -> int:
        return max(1, round(self._params.hop_s * rate_hz))

    def _hop(self, newest: ScanBlock) -> list[Event]:
        """Fit the window; what that has to say."""
        asked, held = self._params.asked, self._held
        fit = self._fit(newest)
        is_good = (
            fit.status == "ok"
            and fit.period_sd_mm <= asked.period_sd_mm
            and fit.angle_sd_deg <= asked.angle_sd_deg
            and fit.frequency_hz * len(held) / newest.rate_hz >= asked.answer_periods
        )
        is_full = self._n_seen >= held.size
        if fit.status == "ok":
            is_said = is_good or is_full or self._has_answer
        else:
            n_hop = self._n_hop(newest.rate_hz)
            n_hops_full = -(-held.size // n_hop)
            is_said = self._has_answer or (is_full and self._n_seen // n_hop % n_hops_full == 0)
        self._has_answer = is_said and fit.status == "ok"
        self._last = fit
        if not is_said:
            return []
        return [self._event(float(newest.time_s[-1]), len(held) / newest.rate_hz, fit)]

    def _fit(self, newest: ScanBlock) -> WaveFit:
        held = self._held
        if newest.late[-1]:
            return WaveFit("stale")
        return fit_wave(
            held.volts,
            held.time_s,
            newest.channel_offset_s,
            self._layout,
            self._motion(),
            self._params,
            held.good,
            np.abs(held.speeds_mm_s),
        )

    def _motion(self) -> WaveMotion:
        slip = self._gate.slip
        assert slip is not None
        direction_deg = slip.direction_deg
        direction_sd_deg = float(np.hypot(slip.direction_sd_deg, _GROOVES_TURN_DEG))
        forward = self._slip_sign
        if self._params.direction_deg is not None:
            direction_deg, direction_sd_deg = self._params.direction_deg, 0.0
            forward = 1.0
        if self._held.sign * forward < 0:
            direction_deg += 180.0
        speed_mm_s = float(np.abs(self._held.speeds_mm_s).mean())
        return WaveMotion(speed_mm_s, self._params.speed_sd_mm_s, direction_deg, direction_sd_deg)

    def _event(self, time_s: float, window_s: float, fit: WaveFit) -> TextureEvent:
        is_given = self._held.sign != 0 and (fit.is_tied or fit.speed_mm_s == 0)
        speed_mm_s = float(np.abs(self._held.speeds_mm_s).mean()) if is_given else fit.speed_mm_s
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
