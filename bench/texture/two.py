"""More than one wave under the array: what is said where two gratings, or a grating and a hum, are in view.

Gratings whose ripples have one frequency (crossed grooves, a knurl) cannot be told by the spectrum; those at
twice or three times another's frequency look, to the spectrum, like harmonics of it. Either grating is a
right answer, and both is a better one; anything else said "ok" is wrong. Where the channels of a taxel feel
both waves alike, the two beat as one under pads that are pressed unevenly does: the hardest to tell.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bench.texture.bound import FloatArray, Wave
from bench.texture.grid import WRONG_TURNS, turns_off
from bench.texture.misfit import WITHIN, full_window
from bench.texture.plates import Spoil
from bench.texture.signal import AMPLITUDE_VOLTS
from bench.texture.window import SNR_DB, SPEED_MM_S, Window, perfect
from tactiled.array import load_array
from tactiled.plain_table import table

WINDOW_S = 10.0
# Of rows so named: windows as first answers have them, and more noise.
_SHORT, _SHORT_S, _SHORT_SNR_DB = ", in 4 s", 4.0, 20.0
_TILTS_DEG = (15.0, 60.0)  # of crossed grooves, either way
_EITHER_DEG = (-50.0, 50.0)  # of two gratings that are not crossed, each
_FINER_MM = (0.7, 1.2)  # of the grating with the higher frequency
_COARSEST_MM = 4.0  # of the other: ten seconds hold two ripples of it


def _beside(
    window: Window, rng: np.random.Generator, wave: Wave, part: float, *, alike: bool = False
) -> None:
    """Put another grating under the skin, of a part of the first one's ripple.

    Channels feel it each kind in a phase of its own, or `alike`: as they feel the first one.
    """
    window.beside = wave
    sensed = window.sensed
    phase_rad = rng.uniform(-np.pi, np.pi, (sensed.kind.max() + 1,))
    size_volts = np.full(len(sensed.kind), AMPLITUDE_VOLTS)
    if alike:
        phase_rad = sensed.phase_rad[:, 0] + phase_rad[0]
        size_volts = sensed.amplitude_volts[:, 0]
    turns = window.turns(wave)
    window.added_volts += part * size_volts * np.cos(2 * np.pi * turns + phase_rad[sensed.kind])


def _crossed(part: float, *, alike: bool = False) -> Spoil:
    def spoil(window: Window, rng: np.random.Generator) -> None:
        tilt_deg = float(rng.uniform(*_TILTS_DEG) * rng.choice([-1, 1]))
        window.wave = replace(window.wave, angle_deg=tilt_deg)
        _beside(window, rng, replace(window.wave, angle_deg=-tilt_deg), part, alike=alike)

    return spoil


def _faster(ratio: float, part: float) -> Spoil:
    """Another grating whose ripple has so many times the frequency."""

    def spoil(window: Window, rng: np.random.Generator) -> None:
        while True:
            angle_deg, finer_deg = float(rng.uniform(*_EITHER_DEG)), float(rng.uniform(*_EITHER_DEG))
            finer_mm = float(rng.uniform(*_FINER_MM))
            period_mm = (
                ratio * finer_mm * float(np.cos(np.radians(angle_deg)) / np.cos(np.radians(finer_deg)))
            )
            if period_mm <= _COARSEST_MM:
                break
        finer = replace(window.wave, period_mm=finer_mm, angle_deg=finer_deg)
        window.wave = replace(window.wave, period_mm=period_mm, angle_deg=angle_deg)
        _beside(window, rng, finer, part)

    return spoil


def _in_step(part: float, ratio: float = 1.0) -> Spoil:
    """All channels breathe together at, or just beside, the grooves' frequency: an eccentric roller, say."""

    def spoil(window: Window, rng: np.random.Generator) -> None:
        turns = ratio * window.wave.frequency_hz * (window.time_s[:, None] + window.sensed.offset_s)
        size = part * AMPLITUDE_VOLTS
        window.added_volts += size * np.cos(2 * np.pi * (turns + rng.uniform(0, 1)))

    return spoil


TWO: dict[str, Spoil] = {
    "crossed, alike": _crossed(1.0),
    "crossed, second at 30 %": _crossed(0.3),
    "crossed, second at 10 %": _crossed(0.1),
    "second of 1.7 times the frequency, at 50 %": _faster(1.7, 0.5),
    "second of twice the frequency, at 50 %": _faster(2.0, 0.5),
    "second of three times the frequency, at 50 %": _faster(3.0, 0.5),
    "all in step at the grooves' frequency, at 30 %": _in_step(0.3),
    "all in step at the grooves' frequency, at 10 %": _in_step(0.1),
    "all in step, 2 % beside that, at 30 %": _in_step(0.3, 1.02),
    "crossed, second at 30 %, felt alike": _crossed(0.3, alike=True),
    f"crossed, second at 30 %{_SHORT}": _crossed(0.3),
    f"crossed, second at 30 %, felt alike{_SHORT}": _crossed(0.3, alike=True),
    f"all in step at the grooves' frequency, at 30 %{_SHORT}": _in_step(0.3),
    f"all in step, 2 % beside that, at 30 %{_SHORT}": _in_step(0.3, 1.02),
}


@dataclass(frozen=True)
class Twofold:
    """What was said of one window.

    Attributes
    ----------
    has_second : bool
        Whether there were two gratings: what is in step everywhere is none.
    is_wrong : bool
        "ok", and the grating said is none of those under the skin.
    names_both : bool
        Both gratings are among what was said, candidates included, whatever the status.
    period_over_sd, angle_over_sd : float
        Errors against the grating that was meant, in stated sigmas; zero where wrong or refused.
    """

    name: str
    is_speed_known: bool
    seed: int
    status: str
    has_second: bool
    is_wrong: bool = False
    names_both: bool = False
    period_over_sd: float = 0.0
    angle_over_sd: float = 0.0


def run_two(advance: Callable[[float], None], pool: Executor, *, n_windows: int) -> list[Twofold]:
    """Every row of `TWO`, seeds 0 to n_windows - 1, speed known and not."""
    jobs = [(name, known) for name in TWO for known in (True, False)]
    found: list[Twofold] = []
    for windows in pool.map(partial(_windows, n_windows), jobs):
        found += windows
        advance(1 / len(jobs))
    return found


def _windows(n_windows: int, job: tuple[str, bool]) -> list[Twofold]:
    return [twofold(*job, seed) for seed in range(n_windows)]


def twofold(name: str, is_speed_known: bool, seed: int) -> Twofold:
    """One window through the online estimator: what it says when the window is full."""
    array = load_array("wang2019-3x3")
    rng = np.random.default_rng(seed)
    window_s, snr_db = (_SHORT_S, _SHORT_SNR_DB) if name.endswith(_SHORT) else (WINDOW_S, SNR_DB)
    window = perfect(array, rng, window_s, snr_db)
    TWO[name](window, rng)
    event = full_window(array, window, rng, window_s, is_speed_known)
    gratings = [window.wave] if window.beside is None else [window.wave, window.beside]
    said = [(event.period_mm, event.angle_deg)] * (event.status == "ok")
    named = [*said, *((c.period_mm, c.angle_deg) for c in event.candidates)]
    off = {wave: _least_off(array.x_mm, array.y_mm, wave, named) for wave in gratings}
    both = len(gratings) == 2 and max(off.values()) <= WRONG_TURNS
    found = Twofold(name, is_speed_known, seed, event.status, len(gratings) == 2, names_both=both)
    if not said:
        return found
    meant = min(gratings, key=lambda wave: _least_off(array.x_mm, array.y_mm, wave, said))
    if _least_off(array.x_mm, array.y_mm, meant, said) > WRONG_TURNS:
        return replace(found, is_wrong=True)
    return replace(
        found,
        period_over_sd=(event.period_mm - meant.period_mm) / event.period_sd_mm,
        angle_over_sd=((event.angle_deg - meant.angle_deg + 90) % 180 - 90) / event.angle_sd_deg,
    )


def _least_off(x_mm: FloatArray, y_mm: FloatArray, wave: Wave, said: Sequence[tuple[float, float]]) -> float:
    return min((turns_off(x_mm, y_mm, wave, *grating) for grating in said), default=np.inf)


def two_table(found: Sequence[Twofold]) -> str:
    """A row for each pair of waves."""
    head = ["what is in view"]
    for known in ("speed known", "unknown"):
        head += [f"{known}: ok", "wrong", "both said, of all", "within 95 %: D, angle"]
    rows = []
    for name in dict.fromkeys(t.name for t in found):
        cells = [name]
        for is_known in (True, False):
            cells += _cells([t for t in found if (t.name, t.is_speed_known) == (name, is_known)])
        refused = Counter(t.status for t in found if t.name == name and t.status != "ok")
        words = ", ".join(f"{status} {n}" for status, n in refused.most_common())
        rows.append([*cells, words or "-"])
    return (
        f"Two waves in view, windows of {WINDOW_S:g} s, the first at {SNR_DB:g} dB ({_SHORT_S:g} s: "
        f"{_SHORT_SNR_DB:g} dB), {SPEED_MM_S:g} mm/s. "
        "Either grating is a right answer; both said: both are among the answer and its candidates, "
        "refusals included.\n\n" + table([*head, "refused as"], rows)
    )


def _cells(windows: Sequence[Twofold]) -> list[str]:
    ok = [t for t in windows if t.status == "ok"]
    right = [t for t in ok if not t.is_wrong]
    period = [abs(t.period_over_sd) <= WITHIN for t in right]
    angle = [abs(t.angle_over_sd) <= WITHIN for t in right]
    return [
        f"{len(ok)} of {len(windows)}",
        str(len(ok) - len(right)),
        str(sum(t.names_both for t in windows)) if all(t.has_second for t in windows) else "-",
        f"{100 * np.mean(period):.0f} %, {100 * np.mean(angle):.0f} %" if right else "-",
    ]
