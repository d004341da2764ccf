"""Aims of the joint estimator.

A measure beyond its limit by less than two of its own standard errors is "open", as is a rate that too few
answers cannot show to be small enough: a quick run leaves most so.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from bench.report import Aim, Reading, grouped, judge, never
from bench.texture.plates import DRAWN_WINDOWS_S, Plate
from bench.texture.spoiled import GROOVELESS
from bench.texture.tables import CONFIDENCE, SPEEDS, TrialSet, windows_of
from bench.texture.tracks import NOTICED_S, Strays
from bench.texture.trials import MIN_PERIODS, QUANTITIES, Quantity, Trial

Found = Mapping[str, Sequence[Trial]]  # by the parts of the bench
_OVER_BOUND = 1.1
_HELD = (0.93, 0.97)  # of 95 % intervals, on white noise
_WRONG = 1e-3  # of answers
_FIRST_S = 3.0  # since slip began
_FIRST_PLATE: Plate = (1.2, 30)  # the demo's
_MOST_REFUSED = 0.02  # of windows over one plate and nothing else
_STRAYS, _STRAYED_ANSWERED = Strays(0.13, 0.0), 0.8
_SURE = 2.0  # standard errors
_NOTHING = judge("nothing answered", False, is_open=True)


def _near_the_bound(quantity: Quantity, is_known: bool, found: Found) -> Reading:
    """Take all noises of a window together, and all windows of a noise: a cell cannot tell 1.1 from 1."""
    mine = [t for t in found["grid"] if t.is_speed_known == is_known and t.periods >= MIN_PERIODS]
    parts = {f"{s:g} s": TrialSet(some) for s, some in grouped(mine, lambda t: t.window_s).items()}
    parts |= {f"{db:g} dB": TrialSet(some) for db, some in grouped(mine, lambda t: t.snr_db).items()}
    parts = {name: part for name, part in parts.items() if part.right}
    if not parts:
        return _NOTHING
    name = max(parts, key=lambda part: parts[part].over_bound(quantity))
    all_words = f"{name}; all {TrialSet(mine).over_bound(quantity):.2f}"
    return _over_bound(quantity, parts[name], all_words)


def _followed(quantity: Quantity, found: Found) -> Reading:
    trials = TrialSet(found["tracks"])
    return _over_bound(quantity, trials, f"{len(trials.bounded)} windows") if trials.bounded else _NOTHING


def _over_bound(quantity: Quantity, trials: TrialSet, words: str) -> Reading:
    error = trials.over_bound(quantity)
    least = error * (1 - _SURE / np.sqrt(2 * len(trials.bounded)))
    return judge(f"{error:.2f} ({words})", error <= _OVER_BOUND, is_open=bool(least <= _OVER_BOUND))


def _held(quantity: Quantity, is_known: bool, found: Found) -> Reading:
    trials = TrialSet(t for t in found["grid"] if t.is_speed_known == is_known)
    # The sigma of intervals that hold what they should: those measured are too few to say how far they stray.
    part, sd = trials.within(quantity), np.sqrt(_HELD[0] * (1 - _HELD[0]) / max(len(trials.ok), 1))
    off = max(_HELD[0] - part, part - _HELD[1])
    return judge(f"{100 * part:.1f} %", off <= 0, is_open=bool(off <= _SURE * sd))


def _rarely_wrong(part: str, found: Found) -> Reading:
    """Judge a rate by its upper 95 % confidence bound, which must be within the limit."""
    trials = TrialSet(found[part])
    words = f"{trials.n_wrong} of {len(trials.ok)} ({100 * CONFIDENCE:.0f} %: below "
    words += f"{1e3 * trials.most_wrong:.2f} in 1000)"
    return judge(words, trials.most_wrong <= _WRONG, is_open=trials.n_wrong <= _WRONG * len(trials.ok))


def _rarely_wrong_slides(found: Found) -> Reading:
    """Answers of one slide are not independent: only their rate is judged."""
    trials = TrialSet(t for t in found["tracks"] if "phase offsets" not in t.name)
    is_met = trials.n_wrong <= _WRONG * len(trials.ok)
    return judge(f"{trials.n_wrong} of {len(trials.ok)}", is_met, is_open=not trials.ok)


def _first(found: Found) -> Reading:
    wanted = ("balanced", *_FIRST_PLATE)
    after_s = [t.after_s for t in found["plates"] if (t.name, t.period.true, t.angle.true) == wanted]
    if not after_s:
        return _NOTHING
    return judge(f"{max(after_s):.1f} s, latest of {len(after_s)}", max(after_s) <= _FIRST_S)


def _strayed(is_known: bool, found: Found) -> Reading:
    mine = [t for t in found["strays"] if (t.name, t.is_speed_known) == (_STRAYS.name, is_known)]
    if not mine:
        return _NOTHING
    part = len(TrialSet(mine).ok) / len(mine)
    most = part + _SURE * np.sqrt(_STRAYED_ANSWERED * (1 - _STRAYED_ANSWERED) / len(mine))
    is_open = bool(most >= _STRAYED_ANSWERED)
    return judge(f"{100 * part:.0f} % of {len(mine)}", part >= _STRAYED_ANSWERED, is_open=is_open)


def _noticed(found: Found) -> Reading:
    after_s = [t.after_s for t in found["changes"]]
    if not after_s:
        return _NOTHING
    late = sum(t > NOTICED_S for t in after_s)
    return judge(f"latest {max(after_s):.1f} s, {late} of {len(after_s)} later", not late)


def _drawn_refused(found: Found) -> Reading:
    full = [t for t in windows_of(found["drawn plates"]) if t.window_s == max(DRAWN_WINDOWS_S)]
    refused, most = sum(t.status != "ok" for t in full), _MOST_REFUSED * len(full)
    is_open = bool(refused - _SURE * np.sqrt(max(refused, 1)) <= most)
    return judge(f"{refused} of {len(full)}", refused <= most, is_open=is_open)


def _wrong(trials: Iterable[Trial]) -> list[bool]:
    return [t.is_wrong for t in trials if t.status == "ok"]


_IN_1000 = f"at most {1e3 * _WRONG:g} in 1000"
AIMS: tuple[Aim[Found], ...] = (
    *(
        Aim(f"{quantity}: error over its bound, {speed}", f"at most {_OVER_BOUND:g}", measure)
        for quantity in QUANTITIES
        for speed, measure in (
            *((speed, partial(_near_the_bound, quantity, known)) for known, speed in SPEEDS.items()),
            ("followed slides", partial(_followed, quantity)),
        )
    ),
    *(
        Aim(
            f"{quantity}: truth within 95 % intervals, {speed}", "93 to 97 %", partial(_held, quantity, known)
        )
        for quantity in QUANTITIES
        for known, speed in SPEEDS.items()
    ),
    *(
        Aim(f"wrong answers, {words}", _IN_1000, partial(_rarely_wrong, part))
        for words, part in (
            ("white noise", "grid"),
            ("coloured noise", "coloured noise"),
            ("phase offsets of 0 to 0.3 rad", "strays"),
        )
    ),
    Aim("wrong answers, followed slides", _IN_1000, _rarely_wrong_slides),
    Aim(
        f"{_FIRST_PLATE[0]:g} mm at {_FIRST_PLATE[1]} deg, balanced: first answer after slip began",
        f"at most {_FIRST_S:g} s",
        _first,
    ),
    *(
        Aim(
            f"phase offsets of {_STRAYS.channel_rad:g} rad, {speed}: answered",
            f"{100 * _STRAYED_ANSWERED:g} %",
            partial(_strayed, known),
        )
        for known, speed in SPEEDS.items()
    ),
    Aim("grooves that change are noticed", f"within {NOTICED_S:g} s", _noticed),
    Aim(
        f"plates drawn at random: windows of {max(DRAWN_WINDOWS_S):g} s refused",
        f"at most {100 * _MOST_REFUSED:g} %",
        _drawn_refused,
    ),
    never("plates drawn at random: wrong answers", lambda found: _wrong(windows_of(found["drawn plates"]))),
    never(
        "plates without grooves: answered",
        lambda found: [t.status == "ok" for t in found["misfits"] if t.name in GROOVELESS],
    ),
    never(
        "spoiled windows: wrong answers",
        lambda found: _wrong(t for t in found["misfits"] if t.name not in GROOVELESS),
    ),
    never("two waves in view: wrong answers", lambda found: _wrong(found["two waves"])),
)
