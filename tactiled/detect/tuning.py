"""The detectors with what people change while they run: zero, sliding speed, thresholds, times not to trust.

`TunedSuite` stands where a suite stands. Untouched it passes everything through, bit by bit. Its settings
survive gaps and replugs; `reset()` is the way back to what the configuration says. Every change takes effect
at a scan boundary, and one that alters what detectors see or compare with is a `Gap` to them, so that no
window holds both kinds. Who records the calls between the blocks can run them again with the same events.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactiled import tomlfile
from tactiled.array import Array, FloatArray
from tactiled.detect.suite import DetectParams, Suite, build_suite
from tactiled.errors import ConfigError
from tactiled.events.types import ContactEvent, Event, SlipEvent, Suppressed
from tactiled.samples.block import Gap, ScanBlock

TARE_S = 0.5  # averaged for a new zero: 50 scans at 100 Hz take white noise down to a seventh
_LEAST_TARE_SCANS = 10  # below 20 Hz, half a second is too few to call a mean
# Means of both halves may differ by this (volts): well above creep of 0.01 V/s in a quarter of a second and
# what is left of 5 mV rms of noise (1.4 mV), well below what a touch brings in the time.
_STILL_VOLTS = 0.01
_KEPT_TIMES = 8  # a slip is found at most some 0.3 s after its onset: more could not matter any more


class _AnnouncedIntervals:
    """Spans of time that someone announced."""

    def __init__(self) -> None:
        self._spans: deque[tuple[float, float]] = deque(maxlen=_KEPT_TIMES)

    def announce(self, now_s: float, duration_s: float) -> None:
        """From now on for a time; said again while one holds, it holds until then."""
        from_s = self._spans.pop()[0] if self.left_s(now_s) > 0 else now_s
        self._spans.append((from_s, now_s + duration_s))

    def left_s(self, now_s: float) -> float:
        """For how much longer the newest holds."""
        return max(0.0, self._spans[-1][1] - now_s) if self._spans else 0.0

    def hold(self, slip: SlipEvent) -> bool:
        """Whether a slip began in one of them, or before and was found in it."""
        return any(slip.onset_s <= until_s and slip.detected_s >= from_s for from_s, until_s in self._spans)


class TunedSuite:
    """A suite of detectors with run-time settings.

    Every command gives the reason why it was refused, empty when it was done, and the events that it brought.

    Parameters
    ----------
    array : Array
    params : DetectParams
    build : callable
        Makes the suite.
    """

    def __init__(
        self,
        array: Array,
        params: DetectParams,
        build: Callable[[Array, DetectParams], Suite] = build_suite,
    ) -> None:
        self._array = array
        self._configured = params
        self._build = build
        self.reset()

    def reset(self) -> None:
        """Forget everything seen and every setting."""
        self.params = self._configured
        """What detectors go by now."""
        self.baseline_volts: FloatArray | None = None
        """(channels,) what is subtracted before detectors see a scan; None before any tare."""
        self.speed_mm_s: float | None = None
        """As last told; None where the configuration's holds."""
        self.next_index = 0
        """Of the first scan that a command given now holds for."""
        self._suite = self._build(self._array, self.params)
        self._recent: deque[ScanBlock] = deque()
        self._inhibited = _AnnouncedIntervals()
        self._load_changes = _AnnouncedIntervals()
        self._in_contact = False
        self._slip_is_told = False  # an onset of this slip was published as valid
        self._slip_suppressed: Suppressed = ""

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Events that the item completes; slips that an announcement explains are said as suppressed."""
        if isinstance(item, Gap):
            self._recent.clear()
        else:
            self._remember(item)
            self.next_index = int(item.index[-1]) + 1
            if self.baseline_volts is not None:
                item = replace(item, volts=item.volts - self.baseline_volts)
        return self._judge(self._suite.process(item))

    def tare(self, *, force: bool) -> tuple[str, list[Event]]:
        """Take the mean of the last `TARE_S` as zero; refused under load unless forced."""
        if self._in_contact and not force:
            return "something is in contact: lift the finger first, or force it if you know better", []
        if not self._recent:
            return "no scans yet", []
        rate_hz = self._recent[-1].rate_hz
        n_wanted = max(_LEAST_TARE_SCANS, round(TARE_S * rate_hz))
        volts = np.concatenate([block.volts for block in self._recent])[-n_wanted:]
        valid: NDArray[np.bool_] = np.concatenate([block.valid for block in self._recent])[-n_wanted:]
        if len(volts) < n_wanted:
            return f"only {len(volts)} scans since the last gap, {n_wanted} are needed: ask again", []
        if not valid.all():
            channels = np.flatnonzero(~valid.all(axis=0)).tolist()
            return f"no valid readings of channels {channels}: mend them first", []
        half = n_wanted // 2
        drift_volts = np.abs(volts[-half:].mean(axis=0) - volts[:half].mean(axis=0)).max()
        if drift_volts > _STILL_VOLTS and not force:
            return f"readings still move by {drift_volts * 1000:.0f} mV: wait until they rest", []
        events = self._part()
        self.baseline_volts = volts.mean(axis=0)
        return "", events

    def forget_zero(self) -> None:
        """Another board: its zero is not known, and what is known of it is that gaps come first."""
        self.baseline_volts = None

    def set_speed(self, speed_mm_s: float) -> None:
        """Sliding speed from the next scan on."""
        if speed_mm_s != self.speed_mm_s:
            self.speed_mm_s = speed_mm_s
            self._pass_speed()

    def inhibit(self, now_s: float, duration_s: float) -> None:
        """Do not trust slips that begin from now on for a time; 0 ends it now."""
        self._inhibited.announce(now_s, duration_s)

    def inhibited_s(self, now_s: float) -> float:
        """For how much longer slips are not trusted."""
        return self._inhibited.left_s(now_s)

    def expect_load_change(self, now_s: float, duration_s: float) -> None:
        """Shear will grow for a reason: for a time trust gross slips, not incipient ones; 0 ends it."""
        self._load_changes.announce(now_s, duration_s)

    def set_thresholds(self, values: Mapping[str, Any]) -> tuple[str, list[Event]]:
        """Change parameters of the detectors by dotted name, as in ``slip.least_shear``."""
        document = self.params.model_dump(exclude_none=True)
        for name, value in values.items():
            place = document["wang2019"] if self.params.setting == "wang2019" else document
            if name.split(".")[0] not in ("slip", "texture"):
                return f"{name}: names begin with slip or texture", []
            *tables, key = name.split(".")
            for table in tables:
                place = place.setdefault(table, {})
                if not isinstance(place, dict):
                    return f"{name}: {table} is no table of parameters", []
            place[key] = value
        try:
            params = tomlfile.parse(document, DetectParams, "")
        except ConfigError as error:
            return "; ".join(fault.removeprefix(self.params.in_use) for fault in error.faults), []
        if params == self.params:
            return "", []
        events = self._part()
        self.params = params
        self._suite = self._build(self._array, params)
        self._pass_speed()
        return "", events

    def _pass_speed(self) -> None:
        if self.speed_mm_s is not None and self._suite.texture is not None:
            self._suite.texture.set_speed(self.speed_mm_s, self.next_index)

    def _part(self) -> list[Event]:
        """Nothing before this moment belongs to anything after it."""
        self._recent.clear()
        return self._judge(self._suite.process(Gap(0, "command", self.next_index))) if self.next_index else []

    def _remember(self, block: ScanBlock) -> None:
        self._recent.append(block)
        wanted = max(_LEAST_TARE_SCANS, round(TARE_S * block.rate_hz))
        have = sum(len(b) for b in self._recent)
        while have - len(self._recent[0]) >= wanted:
            have -= len(self._recent.popleft())

    def _judge(self, events: list[Event]) -> list[Event]:
        out: list[Event] = []
        for event in events:
            if isinstance(event, ContactEvent):
                self._in_contact = event.state != "none"
            elif isinstance(event, SlipEvent) and (reason := self._suppressed(event)):
                event = replace(event, valid=False, suppressed=reason)
            out.append(event)
        return out

    def _suppressed(self, slip: SlipEvent) -> Suppressed:
        """The announcement that explains an event; a slip's end goes with its onsets.

        Nobody should hear of an end alone, and who heard of an onset is told its end.
        """
        if slip.state == "end":
            reason: Suppressed = "" if self._slip_is_told else self._slip_suppressed
            self._slip_is_told, self._slip_suppressed = False, ""
            return reason
        if self._inhibited.hold(slip):
            reason = "inhibit"
        else:
            reason = "load-change" if slip.kind == "incipient" and self._load_changes.hold(slip) else ""
        self._slip_is_told |= not reason
        self._slip_suppressed = reason or self._slip_suppressed
        return reason
