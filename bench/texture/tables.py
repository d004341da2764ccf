"""Tables of ``./run bench texture`` from its trials."""

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from scipy import special

from bench.texture.grid import MIN_PERIODS, Summary, Trial, summary
from tactiled.plain_table import table

_PERIOD_BANDS_MM = (0.6, 0.9, 1.5, 3.0, 6.0)
_ANGLE_BANDS_DEG = (0.0, 15.0, 45.0, 60.0, 75.0)
_COUNT_BANDS = (0.0, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0, 1000.0)
_SURE = 0.95


def over_bound(trials: Sequence[Trial], is_speed_known: bool) -> str:
    """Windows down, noise across: error over bound of the angle / of the period (answered)."""
    counted = [t for t in trials if t.is_speed_known == is_speed_known and t.periods >= MIN_PERIODS]
    windows = sorted({t.window_s for t in trials})
    snrs = sorted({t.snr_db for t in trials})
    head = ["window", *(f"{snr:g} dB" for snr in snrs)]
    rows = [
        [
            f"{window:g} s",
            *(
                summary([t for t in counted if (t.window_s, t.snr_db) == (window, snr)]).cell()
                for snr in snrs
            ),
        ]
        for window in windows
    ]
    return table(head, rows)


def by_band(trials: Sequence[Trial]) -> str:
    """The same trials by what the grating was, and how far stated sigmas can be believed."""
    bands: list[tuple[str, Callable[[Trial], float], Sequence[float]]] = [
        ("period (mm)", lambda t: t.period_mm, _PERIOD_BANDS_MM),
        ("angle (deg)", lambda t: abs(t.angle_deg), _ANGLE_BANDS_DEG),
        ("periods in the window", lambda t: t.periods, _COUNT_BANDS),
    ]
    rows = []
    for name, value, edges in bands:
        for low, high in pairwise(edges):
            rows.append(_row(f"{name} {low:g} to {high:g}", [t for t in trials if low <= value(t) < high]))
    for is_known, words in ((True, "speed known"), (False, "speed unknown")):
        rows.append(_row(words, [t for t in trials if t.is_speed_known == is_known]))
    rows.append(_row("all", trials))
    head = [
        "trials", "windows", "answered", "error / bound: angle", "period", "within 95 %: angle", "period",
        "wrong",
    ]  # fmt: skip
    return table(head, rows)


def _row(name: str, trials: Sequence[Trial]) -> list[str]:
    found = summary(trials)
    if not found.ok:
        return [name, str(found.trials), "0", *["-"] * 4, "0"]
    return [
        name,
        str(found.trials),
        f"{found.ok} ({100 * found.ok / found.trials:.0f} %)",
        f"{found.angle:.2f}",
        f"{found.period:.2f}",
        f"{100 * found.angle_within:.1f} %",
        f"{100 * found.period_within:.1f} %",
        str(found.wrong),
    ]


def most_wrong(found: Summary) -> float:
    """Largest part of wrong answers that is not excluded (one-sided, Clopper and Pearson 1934)."""
    right = found.ok - found.wrong
    return float(special.betaincinv(found.wrong + 1, right, _SURE)) if right else 1.0


def wrong_rate(trials: Sequence[Trial]) -> str:
    """Wrong ambiguities among answers, with the largest rate that is not excluded."""
    found = summary(trials)
    return (
        f"Wrong ambiguity: {found.wrong} of {found.ok} answers that said ok "
        f"(below {1e3 * most_wrong(found):.2f} in 1000 with {100 * _SURE:.0f} % confidence: "
        "Clopper, Pearson 1934)."
    )


def refusals(trials: Sequence[Trial]) -> str:
    """What the estimator says instead of an answer."""
    counted = Counter(t.status for t in trials if not t.is_ok)
    words = ", ".join(f"{status} {number}" for status, number in counted.most_common())
    return f"Refused: {words or 'nothing'}."


def threshold(trials: Sequence[Trial]) -> str:
    """Least noise ratio at which 9 of 10 windows of `MIN_PERIODS` or more are answered, by window."""
    rows = []
    for window in sorted({t.window_s for t in trials}):
        cells = [f"{window:g} s"]
        for is_known in (True, False):
            least = "none"
            for snr in sorted({t.snr_db for t in trials}, reverse=True):
                here = [
                    t
                    for t in trials
                    if (t.window_s, t.snr_db, t.is_speed_known) == (window, snr, is_known)
                    and t.periods >= MIN_PERIODS
                ]
                if not here or np.mean([t.is_ok for t in here]) < 0.9:
                    break
                least = f"{snr:g} dB"
            cells.append(least)
        rows.append(cells)
    return table(["window", "speed known: answers from", "speed unknown: answers from"], rows)
