"""Simple rules that the daemon is measured against, and trees as an upper reference.

What a rule or trees need to learn comes from the other groups of logs: they are scored on what they have not
seen.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.recordings.log import Log
from tactiled.array import FloatArray
from tactiled.calibrate.folds import folds, segments

_LEVELS = 200  # thresholds that are tried, at the quantiles of the scores
_CHANGE_S = 0.8  # of 0.05, 0.1, 0.2, 0.4 and 0.8 the best on tugs, and nearly so on electrodes
_START_S = 0.3
_MOVES_SCANS = 8
# Of the largest: below, the centre of a pad and the shape of the channels are those of noise.
_LEAST_LOAD = 0.2
# Power of changes from scan to scan at the strongest line over the median: 21 of the 24 slides of FabricSlide
# have more with the right line, 7 of 40 slides over other materials have more.
_LINE_OVER_BAND = 30.0
_LEAST_CYCLES = 3
_FEATURE_S = (0.05, 0.1, 0.2, 0.4, 0.8)


def median_change(log: Log) -> float:
    """Return the largest change in 0.8 s of the median channel."""
    return float(np.median(np.abs(_change(log, _CHANGE_S)), axis=1).max())


def norm_change(log: Log) -> float:
    """Return the largest change in 0.8 s of all channels together."""
    return float(np.linalg.norm(_change(log, _CHANGE_S), axis=1).max())


def load_fall(log: Log) -> float:
    """Return the largest fall in 0.8 s of all channels together, as a part of the most that they reach."""
    size = np.linalg.norm(log.readings - _start(log), axis=1)
    hop = _hop(log, _CHANGE_S)
    return float((size[:-hop] - size[hop:]).max() / size.max())


def shape_change(log: Log) -> float:
    """Return the largest change in 0.8 s of the channels over their norm, at a fifth of its top or more."""
    pressed = log.readings - _start(log)
    size = np.linalg.norm(pressed, axis=1)
    hop, least = _hop(log, _CHANGE_S), _LEAST_LOAD * size.max()
    shape = pressed / np.maximum(size, least)[:, np.newaxis]
    goes_on = (size[hop:] > least) & (size[:-hop] > least)
    return float(np.linalg.norm(shape[hop:] - shape[:-hop], axis=1)[goes_on].max(initial=0.0))


def centre_change(log: Log) -> float:
    """Return how far the centre of pressure of a pad moves in eight scans at most, in taxels."""
    moves = [0.0]
    for rows, columns, first in log.pads:
        cells = log.readings[:, first : first + rows * columns]
        total = cells.sum(axis=1)
        y, x = np.divmod(np.arange(rows * columns), columns)
        loaded = total > _LEAST_LOAD * total.max()
        centre = np.stack([cells @ x, cells @ y], axis=1) / np.maximum(total, 1e-9)[:, np.newaxis]
        step = np.linalg.norm(centre[_MOVES_SCANS:] - centre[:-_MOVES_SCANS], axis=1)
        stays = loaded[_MOVES_SCANS:] & loaded[:-_MOVES_SCANS]
        moves.append(float(step[stays].max(initial=0.0)))
    return max(moves)


LOG_RULES: dict[str, Callable[[Log], float]] = {
    "median change": median_change,
    "norm change": norm_change,
    "load fall": load_fall,
    "shape change": shape_change,
    "centre of pressure": centre_change,
}


def by_threshold(logs: Sequence[Log], score: Callable[[Log], float]) -> list[bool]:
    """Decide for each log whether its label holds, by the threshold that is best on the other groups."""
    scores = np.array([score(log) for log in logs])
    label = np.array([log.label for log in logs])
    groups = np.array([log.group for log in logs])
    said = []
    for one, group in zip(scores, groups, strict=True):
        others = groups != group
        levels = np.unique(np.quantile(scores[others], np.linspace(0, 1, _LEVELS)))
        found, quiet = scores[others & label], scores[others & ~label]
        right = np.array([(found >= level).mean() + (quiet < level).mean() for level in levels])
        said.append(bool(one >= levels[right == right.max()].mean()))
    return said


def by_best_of_others(logs: Sequence[Log], said: NDArray[np.bool_]) -> list[bool]:
    """Decide for each log by the choice, of those said (choices, logs), that is best on the other groups."""
    label = np.array([log.label for log in logs])
    groups = np.array([log.group for log in logs])
    decided = []
    for at, group in enumerate(groups):
        found, quiet = said[:, (groups != group) & label], ~said[:, (groups != group) & ~label]
        decided.append(bool(said[np.argmax(found.mean(axis=1) + quiet.mean(axis=1)), at]))
    return decided


def agreement(said: NDArray[np.bool_], log: Log) -> float:
    """Return the part of scans that are said right, mean of pressed and of free ones; 0.5 is chance.

    Scans with a light force are left out.
    """
    return float(said[log.is_pressed].mean() + (~said[log.is_free]).mean()) / 2


def contact_by_norm(logs: Sequence[Log]) -> list[float]:
    """Return the agreement with the force of one threshold on the readings, best on the other logs."""
    sizes = [np.linalg.norm(log.readings - _start(log), axis=1) for log in logs]
    levels = np.unique(np.quantile(np.concatenate(sizes), np.linspace(0, 1, _LEVELS)))
    right = np.array(
        [[agreement(size >= level, log) for level in levels] for size, log in zip(sizes, logs, strict=True)]
    )
    others = right.sum(axis=0) - right
    return [float(own[best]) for own, best in zip(right, others.argmax(axis=1), strict=True)]


def _start(log: Log) -> FloatArray:
    return np.asarray(np.median(log.readings[log.time_s < log.time_s[0] + _START_S], axis=0))


def by_trees(logs: Sequence[Log]) -> list[bool]:
    """Decide for each log whether its label holds, by boosted trees that learnt from the other groups."""
    from sklearn.ensemble import HistGradientBoostingClassifier  # takes seconds to load
    from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict

    trees = HistGradientBoostingClassifier(min_samples_leaf=5, class_weight="balanced", random_state=0)
    features, label = [_features(log) for log in logs], [log.label for log in logs]
    groups = [log.group for log in logs]
    said = cross_val_predict(trees, features, label, groups=groups, cv=LeaveOneGroupOut())
    return [bool(one) for one in said]


def ridge_of_resistance(log: Log, at_s: FloatArray, reference: FloatArray, used: Sequence[int]) -> FloatArray:
    """Return the rms errors of ridge regression on 1/v and log v, in folds that leave out whole contacts.

    The reference (n, 6) has the forces `used`, at times (n,) from the first scan on.
    """
    readings = np.stack([np.interp(at_s, log.time_s - log.time_s[0], one) for one in log.readings.T], axis=1)
    start = _start(log)
    features = np.concatenate([start / readings, np.log(readings / start), np.ones((len(at_s), 1))], axis=1)
    features[:, :-1] /= features[:, :-1].std(axis=0)
    forces = reference[:, used]
    squares = np.zeros(forces.shape)
    for left_out in folds(segments(reference, list(used), float(np.median(np.diff(at_s))))):
        own, other = features[left_out], features[~left_out]
        gram = other.T @ other + 1e-6 * len(other) * np.eye(features.shape[1])
        weights = np.linalg.solve(gram, other.T @ forces[~left_out])
        squares[left_out] = (forces[left_out] - own @ weights) ** 2
    return np.asarray(np.sqrt(squares.mean(axis=0)))


RIDGES = {"ridge with squares": None, "ridge on 1/v and log v": ridge_of_resistance}


def pose_errors_of_trees(log: Log) -> FloatArray:
    """Return the rms errors of boosted trees over the range of each axis, in five random folds of poses."""
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.model_selection import KFold, cross_val_predict

    assert log.forces is not None
    forces = log.forces[:, ~np.isnan(log.forces).all(axis=0)]
    parts = KFold(5, shuffle=True, random_state=0)
    said = [
        cross_val_predict(HistGradientBoostingRegressor(random_state=0), log.readings, force, cv=parts)
        for force in forces.T
    ]
    errors = np.sqrt(((np.stack(said, axis=1) - forces) ** 2).mean(axis=0))
    return np.asarray(errors / np.ptp(forces, axis=0))


def _features(log: Log) -> list[float]:
    """Changes over five times: of the median channel, of the fifth that changes most, of all, of the mean."""
    found = []
    for over_s in _FEATURE_S:
        change = np.abs(_change(log, over_s))
        found += [
            float(np.median(change, axis=1).max()),
            float(np.quantile(change, 0.8, axis=1).max()),
            float(np.linalg.norm(change, axis=1).max()),
            float(np.median(np.linalg.norm(change, axis=1))),
            float(np.abs(_change(log, over_s).mean(axis=1)).max()),
        ]
    return found


def _hop(log: Log, over_s: float) -> int:
    return max(1, min(round(over_s / log.step_s), len(log.readings) - 1))


def _change(log: Log, over_s: float) -> FloatArray:
    hop = _hop(log, over_s)
    return np.asarray(log.readings[hop:] - log.readings[:-hop])


def strongest_line_hz(log: Log) -> float:
    """Return the strongest line of the changes from scan to scan, pooled; 0 where it does not stand out."""
    at_s = np.arange(log.time_s[0], log.time_s[-1], log.step_s)
    even = np.stack([np.interp(at_s, log.time_s, one) for one in log.readings.T], axis=1)
    change = np.diff(even, axis=0)
    window = np.hanning(len(change))[:, np.newaxis]
    power = (np.abs(np.fft.rfft(window * (change - change.mean(axis=0)), axis=0)) ** 2).sum(axis=1)
    power[:_LEAST_CYCLES] = 0.0
    peak = int(np.clip(np.argmax(power), 1, len(power) - 2))
    left, middle, right = power[peak - 1 : peak + 2]
    shift = 0.5 * (left - right) / (left - 2 * middle + right)
    stands_out = middle > _LINE_OVER_BAND * np.median(power[_LEAST_CYCLES:])
    return float((peak + shift) / (len(change) * log.step_s)) if stands_out else 0.0
