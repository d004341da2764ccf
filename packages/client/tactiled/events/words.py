"""Messages in words, one line each, for people. The page has the same words in `static/words.js`.

Every function takes the map of a message as `incoming.checked_map` returns it, and computes from it alone.
"""

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

from tactiled.events.codec import evidence_key
from tactiled.events.types import UNKNOWN_SD_N, ForceEvent

_WAYS = ("+x", "+x +y", "+y", "-x +y", "-x", "-x -y", "-y", "+x -y")
_UNKNOWN_WAY_SD_DEG = 90.0  # a direction that may as well be the opposite one
_LEAST_SD = 1e-9  # more digits than any reading has
# Interval of lines that give one state again with other numbers; instants of scans are not exact to less.
_REPEAT_S = 1.0 - 0.0005

# Fields whose change is shown at once, of topics that have a message for each scan, fit or moment. Of the
# other topics every message is an event of its own.
_STATE_OF: Mapping[str, tuple[str, ...]] = {
    "grip": ("state", "valid", "suppressed"),
    "texture": ("status",),
    "force": ("calibration", "valid", "saturated"),
    "status": ("state", "valid", "reason", "warning"),
    "recording": ("state", "reason", "file"),
    "info": ("board_serial", "array_id"),
    "scan": (),
}
# Topics that come all the time, whether anything happens or not: shown to those who ask for them by name.
_UNASKED = frozenset(("scan", "force", "status", "info", "recording"))


class EventLines:
    """Lines for people from a stream of messages, at a rate that can be read.

    What comes with each scan or fit is shown when its state changes, and else once a second. Where there are
    messages of several boards, each line names its board.
    `instant` has words for the instant of a message. Without `topics` that were asked for, all are shown but
    those that come whether anything happens or not.
    """

    def __init__(self, instant: Callable[[float], str], topics: Collection[str] = ()) -> None:
        self._instant = instant
        self._topics = frozenset(topics)
        self._shown: dict[tuple[str, str], tuple[float, tuple[object, ...]]] = {}
        self._boards: set[str] = set()

    def line(self, topic: str, data: Mapping[str, Any], mark: str = "") -> str | None:
        """Return the line of a message, with `mark` at its end; None where none is due."""
        is_asked = topic in self._topics if self._topics else topic not in _UNASKED
        if not is_asked:
            return None
        self._boards.add(data["board"])
        at_s = float(data[evidence_key(topic)])
        if topic in _STATE_OF and not self._is_due(topic, data, at_s):
            return None
        board = (f"{data['board'] or '-'}  ",) if len(self._boards) > 1 else ()
        return printable("".join((self._instant(at_s), "  ", *board, event_words(topic, data), mark)))

    def _is_due(self, topic: str, data: Mapping[str, Any], at_s: float) -> bool:
        key, state = (data["board"], topic), tuple(data[name] for name in _STATE_OF[topic])
        shown_s, shown = self._shown.get(key, (-math.inf, ()))
        if state == shown and 0.0 <= at_s - shown_s < _REPEAT_S:  # a clock that was set back silences nothing
            return False
        self._shown[key] = (at_s, state)
        return True


def event_words(topic: str, data: Mapping[str, Any]) -> str:
    """Describe a message in one line, without its instant and its board.

    Examples
    --------
    >>> event_words("contact", {"previous": "none", "state": "loading"})
    'contact none -> loading'
    """
    return _WORDS[topic](data)


def texture_words(data: Mapping[str, Any]) -> str:
    """Describe a groove estimate, or why there is none."""
    period = f"{with_sd(data['period_mm'], data['period_sd_mm'])} mm"
    if data["status"] == "ok":
        return f"grooves {period} at {with_sd(data['angle_deg'], data['angle_sd_deg'])}°"
    if data["status"] == "period-only":
        return f"ripple {period}, angle unknown"
    return f"no groove estimate: {data['status']}"


def force_words(data: Mapping[str, Any]) -> str:
    """Describe a force in newtons, or why it is not known in newtons."""
    if data["calibration"] in ForceEvent.UNCALIBRATED:
        return "not calibrated: tactiled calibrate"
    if not data["valid"]:
        return "not valid"
    limit = ">= " if data["saturated"] else ""
    normal, shear = "not known", "not known"
    if data["fz_sd_n"] < UNKNOWN_SD_N:
        normal = f"{limit}{with_sd(data['fz_n'], data['fz_sd_n'])} N"
    if max(data["fx_sd_n"], data["fy_sd_n"]) < UNKNOWN_SD_N:
        shear = f"{math.hypot(data['fx_n'], data['fy_n']):.1f} N"
    return f"{normal}, shear {shear}"


def way(direction_deg: float, sd_deg: float) -> str:
    """Name the way of the skin over the surface by axes; empty where it is not known.

    Examples
    --------
    >>> way(-88.0, 5.0), way(0.0, 180.0)
    ('-y', '')
    """
    return "" if sd_deg >= _UNKNOWN_WAY_SD_DEG else _WAYS[round(direction_deg / 45) % 8]


def lost_words(status: Mapping[str, Any]) -> str:
    """Number of lost scans, or that it is not known: frames without a sequence number do not tell."""
    if not status["loss_known"]:
        return "lost scans not known"
    return f"{status['scans_missing']} of {status['scans']} lost"


def with_sd(value: float, sd: float) -> str:
    """Format a number to the digits that its standard deviation allows.

    Examples
    --------
    >>> with_sd(1.20003, 0.0041), with_sd(1.20003, 0.00013), with_sd(31.4, 27.0)
    ('1.200 ± 0.004', '1.20003 ± 0.00013', '31 ± 27')
    """
    power = math.floor(math.log10(max(sd, _LEAST_SD)))
    places = max(0, int(sd / 10.0**power < 2) - power)  # one digit of the deviation, two below 2
    return f"{value:.{places}f} ± {sd:.{places}f}"


def printable(text: str) -> str:
    """Replace control characters, with which a foreign publisher could command the terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def _slip(data: Mapping[str, Any]) -> str:
    lasted_s = data["detected"] - data["onset"]
    if data["state"] == "end":
        words = f"{data['kind']} slip ended after {lasted_s:.2f} s"
    else:
        words = f"{data['kind']} slip"
        if towards := way(data["direction_deg"], data["direction_sd_deg"]):
            sd_deg = max(1, round(data["direction_sd_deg"]))
            words += f" towards {towards} ({round(data['direction_deg'])} ± {sd_deg}°)"
        if data["valid"]:
            words += f", p {data['confidence']:.2f}, latency {1000 * lasted_s:.0f} ms"
    return words + _faults(data)


def _grip(data: Mapping[str, Any]) -> str:
    if data["state"] == "none":
        return "grip none"
    load = f", load {data['load']:.1f} N" if data["unit"] == "N" else ""  # other units have no meaning
    if data["state"] == "unknown":
        return f"grip unknown, how much of the limit is in use is not known{load}{_faults(data)}"
    used, low, high = (round(100 * data[f"utilisation{end}"]) for end in ("", "_low", "_high"))
    return f"grip {data['state']}, {used} % of the limit in use ({low} to {high}){load}{_faults(data)}"


def _faults(data: Mapping[str, Any]) -> str:
    """Say why a message is not to be acted on; empty where it is."""
    if data["suppressed"]:
        return f", suppressed: {data['suppressed']}"
    return "" if data["valid"] else ", not valid"


def _command(data: Mapping[str, Any]) -> str:
    words = f"{data['command']} by {data['who'] or '?'}"
    return words if data["ok"] else f"{words} refused: {data['reason']}"


def _scan(data: Mapping[str, Any]) -> str:
    known = [volts for volts, valid in zip(data["volts"], data["valid"], strict=True) if valid]
    readings = f"{len(known)} of {len(data['volts'])} readings valid"
    if known:
        readings += f", {min(known):.4g} to {max(known):.4g}"
    return f"scan {data['index']}: {readings}{', late' if data['late'] else ''}"


def _status(data: Mapping[str, Any]) -> str:
    words = f"status {data['state']}, {data['rate_hz']:.1f} Hz, {lost_words(data)}"
    return "; ".join(part for part in (words, data["reason"], data["warning"]) if part)


def _info(data: Mapping[str, Any]) -> str:
    return (
        f"board {data['board_serial']}: array {data['array_id']}, {data['taxels']} taxels, "
        f"{data['channels']} channels, {data['rate_hz']:g} Hz"
    )


def _recording(data: Mapping[str, Any]) -> str:
    words = f"recording {data['state']}, {data['bytes_written'] / 1e6:.1f} MB"
    return "; ".join(part for part in (words, data["reason"], data["file"]) if part)


_WORDS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "slip": _slip,
    "contact": lambda data: f"contact {data['previous']} -> {data['state']}",
    "grip": _grip,
    "texture": texture_words,
    "force": lambda data: f"force {force_words(data)}",
    "command": _command,
    "scan": _scan,
    "status": _status,
    "info": _info,
    "recording": _recording,
}
