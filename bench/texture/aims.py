"""What texture set out to reach, and whether it did.

A measure beyond its limit by less than two of its own standard errors is "open", as is a rate that too few
answers cannot show to be small enough: a quick run leaves most so.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from bench.texture.count import Counted
from bench.texture.drawn import WINDOWS_S, Drawn
from bench.texture.grid import MIN_PERIODS, Summary, Trial, summary
from bench.texture.misfit import Spoiled
from bench.texture.paper import Answered, First, Plate
from bench.texture.plates import GROOVELESS
from bench.texture.tables import most_wrong
from bench.texture.two import Twofold
from tactiled.plain_table import table

_OVER_BOUND = 1.1
_HELD = (0.93, 0.97)  # of 95 % intervals, on white noise
_WRONG = 1e-3  # of answers that say ok
# Over some plates at 0 degrees all lags are 0 scans: that says nothing of how well an angle is known.
_BY_ITS_GRID = 1e-9
_TIMES = {"joint, 10 s": 10.0, "joint, 2 s": 1.0}  # smaller than the procedure's errors of 10 s
_FIRST_S = 3.0  # since slip began
_FIRST_PLATE: Plate = (1.2, 30)  # the demo's
_MOST_REFUSED = 0.02  # of windows over one plate and nothing else
_SURE = 2.0  # standard errors
Verdict = Literal["met", "open", "MISSED"]
Row = tuple[str, str, str, Verdict]


def aims_table(
    grid: Sequence[Trial],
    coloured: Sequence[Counted],
    plates: Sequence[Answered],
    firsts: Sequence[First],
    drawn: Sequence[Drawn],
    misfits: Sequence[Spoiled],
    twofold: Sequence[Twofold],
) -> str:
    """Aim, limit, measured, met or missed; the worst of all that was measured.

    Parameters
    ----------
    grid : sequence of Trial
        Of the joint estimator in white noise.
    """
    rows = _near_the_bound(grid) + _held(grid) + _wrong(grid, coloured)
    rows += [row for method, least in _TIMES.items() for row in _smaller(plates, method, least)]
    rows += _first(firsts)
    rows += _drawn(drawn)
    bare = [s for s in misfits if s.name in GROOVELESS]
    rows.append(_at_most("plates without grooves: answered", [s.status == "ok" for s in bare]))
    rest = [s for s in misfits if s.name not in GROOVELESS and s.status == "ok"]
    rows.append(_at_most("spoiled windows: wrong of those answered", [s.is_wrong for s in rest]))
    two = [t for t in twofold if t.status == "ok"]
    rows.append(_at_most("two waves in view: wrong of those answered", [t.is_wrong for t in two]))
    return "Aims, worst case of what was measured; open: too few windows to tell.\n\n" + table(
        ["aim", "limit", "measured", ""], [list(row) for row in rows]
    )


def _verdict(is_met: bool, is_open: bool = False) -> Verdict:
    return "met" if is_met else "open" if is_open else "MISSED"


def _near_the_bound(grid: Sequence[Trial]) -> list[Row]:
    """All noises of a window together, and all windows of a noise: a cell alone cannot tell 1.1 from 1."""
    rows = []
    for what in ("angle", "period"):
        for is_known, words in ((True, "known"), (False, "unknown")):
            mine = [t for t in grid if t.is_speed_known == is_known and t.periods >= MIN_PERIODS]
            parts: dict[str, list[Trial]] = {}
            for t in mine:
                parts.setdefault(f"{t.window_s:g} s", []).append(t)
                parts.setdefault(f"{t.snr_db:g} dB", []).append(t)
            measured, verdict = _worst({name: summary(part) for name, part in parts.items()}, what)
            measured = f"{measured}; all {getattr(summary(mine), what):.2f}"
            name = f"error of the {what} over its bound, speed {words}"
            rows.append((name, f"at most {_OVER_BOUND:g}", measured, verdict))
    return rows


def _worst(parts: dict[str, Summary], what: str) -> tuple[str, Verdict]:
    """The part where the error is largest over its bound."""
    errors = {name: float(getattr(part, what)) for name, part in parts.items() if part.ok > part.wrong}
    if not errors:
        return "nothing answered", "open"
    name = max(errors, key=lambda part: errors[part])
    sd = errors[name] / np.sqrt(2 * (parts[name].ok - parts[name].wrong))
    is_open = bool(errors[name] - _SURE * sd <= _OVER_BOUND)
    return f"{errors[name]:.2f} ({name})", _verdict(errors[name] <= _OVER_BOUND, is_open)


def _held(grid: Sequence[Trial]) -> list[Row]:
    rows = []
    for is_known, words in ((True, "known"), (False, "unknown")):
        found = summary([t for t in grid if t.is_speed_known == is_known])
        limit = f"{100 * _HELD[0]:.0f} to {100 * _HELD[1]:.0f} %"
        for what, held in (("angle", found.angle_within), ("period", found.period_within)):
            name = f"95 % intervals of the {what} hold, white noise, speed {words}"
            # Of intervals that hold what they should: those measured are too few to say how far they stray.
            sd = np.sqrt(_HELD[0] * (1 - _HELD[0]) / max(found.ok, 1))
            off = max(_HELD[0] - held, held - _HELD[1])
            rows.append((name, limit, f"{100 * held:.1f} %", _verdict(off <= 0, bool(off <= _SURE * sd))))
    return rows


def _wrong(grid: Sequence[Trial], coloured: Sequence[Counted]) -> list[Row]:
    """Met is what the count proves: the rate that it does not exclude is within the limit."""
    rows = [_rate("white noise", grid)]
    for memory in dict.fromkeys(c.memory for c in coloured):
        rows.append(_rate(f"noise AR(1) {memory:g}", [c.trial for c in coloured if c.memory == memory]))
    return rows


def _rate(name: str, trials: Sequence[Trial]) -> Row:
    found = summary(trials)
    most = most_wrong(found)
    measured = f"{found.wrong} of {found.ok} (95 %: below {1e3 * most:.2f} in 1000)"
    verdict = _verdict(most <= _WRONG, found.wrong <= _WRONG * found.ok)
    return f"wrong of those that say ok, {name}", f"at most {1e3 * _WRONG:g} in 1000", measured, verdict


def _smaller(plates: Sequence[Answered], method: str, least: float) -> list[Row]:
    """Against the procedure, on the plate where least is won; one that the procedure refuses says nothing."""
    errors = {(a.plate, a.method): a.errors() for a in plates}
    rows: list[Row] = []
    for k, what in enumerate(("period", "angle")):
        base = {plate: error[k] for (plate, of), error in errors.items() if of == "procedure"}
        exact = [plate for plate, error in base.items() if error < _BY_ITS_GRID]
        times = {plate: base[plate] / errors[plate, method][k] for plate in base if plate not in exact}
        silent = [p for p in times if np.isfinite(base[p]) and not np.isfinite(errors[p, method][k])]
        times = {plate: ratio for plate, ratio in times.items() if np.isfinite(ratio)}
        name = f"errors of the {what} smaller than the procedure's of 10 s: {method}"
        if not times:
            rows.append((name, f"{least:g} times", "no plate answered by both", "open"))
            continue
        worst = min(times, key=lambda plate: times[plate])
        words = (
            f"{times[worst]:.1f} times ({worst[0]:g} mm, {worst[1]} deg; {len(times)} of {len(base)} plates"
        )
        words += f", the procedure is exact by its grid on {len(exact)})" if exact else ")"
        if silent:
            words += "; never answered: " + ", ".join(f"{mm:g} mm, {deg} deg" for mm, deg in silent)
        rows.append((name, f"{least:g} times", words, _verdict(times[worst] >= least and not silent)))
    return rows


def _first(firsts: Sequence[First]) -> list[Row]:
    after_s = [f.after_s for f in firsts if f.plate == _FIRST_PLATE and f.preset == "balanced"]
    if not after_s:
        return []
    name = f"{_FIRST_PLATE[0]:g} mm at {_FIRST_PLATE[1]} deg, balanced: first answer after slip began"
    measured = f"{max(after_s):.1f} s, latest of {len(after_s)}"
    return [(name, f"at most {_FIRST_S:g} s", measured, _verdict(max(after_s) <= _FIRST_S))]


def _drawn(drawn: Sequence[Drawn]) -> list[Row]:
    full = [d for d in drawn if d.window_s == max(WINDOWS_S)]
    refused, most = sum(d.status != "ok" for d in full), _MOST_REFUSED * len(full)
    measured = f"{refused} of {len(full)}"
    name = f"plates drawn at random: windows of {max(WINDOWS_S):g} s refused"
    limit = f"at most {100 * _MOST_REFUSED:g} %"
    is_open = refused - _SURE * np.sqrt(max(refused, 1)) <= most
    return [
        (name, limit, measured, _verdict(refused <= most, bool(is_open))),
        _at_most(
            "plates drawn at random: wrong of those answered", [d.is_wrong for d in drawn if d.status == "ok"]
        ),
    ]


def _at_most(name: str, happened: Sequence[bool]) -> Row:
    """What must never happen."""
    number = sum(happened)
    return name, "none", f"{number} of {len(happened)}", _verdict(number == 0)
