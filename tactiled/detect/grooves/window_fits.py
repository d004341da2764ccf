"""The fits of a window that a worker computes; their modules are loaded with the first of them, or by `load`.

They need scipy.special, which is slow to load. A file without slides never needs it, and the daemon loads it
in the thread of its fits, beside the start of the board.
"""

from tactiled.detect.grooves.outcome import GrooveAnswer, NewPattern, Outcome
from tactiled.detect.grooves.window import FitWindow


def load() -> None:
    """Load the modules of all fits."""
    from tactiled.detect.grooves import period_only, track  # noqa: F401


def fit_wave(window: FitWindow) -> Outcome:
    """Fit a wave, as `fit.fit_wave` says."""
    from tactiled.detect.grooves import fit

    return fit.fit_wave(window)


def fit_line(window: FitWindow) -> Outcome:
    """Fit a period without an angle, as `period_only.fit_line` says."""
    from tactiled.detect.grooves import period_only

    return period_only.fit_line(window)


def fit_wave_or_line(window: FitWindow) -> Outcome:
    """Fit a wave, or else a period without an angle, as `period_only.fit_wave_or_line` says."""
    from tactiled.detect.grooves import period_only

    return period_only.fit_wave_or_line(window)


def track_wave(last: GrooveAnswer, scans: FitWindow, *, is_full: bool) -> GrooveAnswer | NewPattern | None:
    """Follow a fitted wave into the next window, as `track.track_wave` says."""
    from tactiled.detect.grooves import track

    return track.track_wave(last, scans, is_full=is_full)
