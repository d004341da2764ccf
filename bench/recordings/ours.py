"""Answers of the daemon on a log, by the detectors and parameters that `tactiled detect` runs."""

from collections.abc import Callable, Sequence
from typing import NamedTuple
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from bench.recordings.log import Log
from tactiled.array import Array, FloatArray
from tactiled.calibrate.data import ReferenceTable
from tactiled.calibrate.study import calibrate
from tactiled.detect.signal.slip_gate import KnownSliding
from tactiled.detect.sliding import growth
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.detect.tuning import TunedSuite
from tactiled.errors import DataError
from tactiled.events.types import ContactEvent, Event, GripEvent, SlipEvent, TextureEvent
from tactiled.recording.spacing import to_blocks

Ridge = Callable[[Log, FloatArray, FloatArray, Sequence[int]], FloatArray]

_TILT_DEG = 10.0  # what is said of gratings across the motion
_Z90 = 1.645


def slips(log: Log, array: Array) -> bool:
    """Return True where an onset is reported."""
    return bool(_onsets(log, array))


def slips_grossly(log: Log, array: Array) -> bool:
    """Return True where the onset of a gross slip is reported."""
    return any(event.kind == "gross" for event in _onsets(log, array))


def largest_p_sliding(log: Log, array: Array) -> float:
    """Return the largest probability of sliding of a log; 0 where there is none."""
    found = _events(log, array, DetectParams(), ("grip",))
    return max((event.p_sliding for event in found if isinstance(event, GripEvent)), default=0.0)


def _onsets(log: Log, array: Array) -> list[SlipEvent]:
    found = _events(log, array, DetectParams(), ("slip",))
    return [event for event in found if isinstance(event, SlipEvent) and event.state == "onset"]


def slips_by_growth(logs: Sequence[Log], array: Array, growths: Sequence[float]) -> NDArray[np.bool_]:
    """Return (growths, logs) where an onset is reported, with each limit of the growth of load that moves."""
    found = []
    for limit in growths:
        with mock.patch.object(growth, "HOLDS_MOVE", limit):
            found.append([slips(log, array) for log in logs])
    return np.array(found)


def contact(log: Log, array: Array) -> NDArray[np.bool_]:
    """Return the scans (n,) in contact, whatever its state, as `tactiled detect` counts it."""
    found = _events(log, array, DetectParams(), ("contact",))
    changes = [event for event in found if isinstance(event, ContactEvent)]
    is_on = np.array([False, *(event.state != "none" for event in changes)])
    return np.asarray(is_on[np.searchsorted([e.evidence_s for e in changes], log.time_s, side="right")])


def touches(log: Log, array: Array) -> bool:
    """Return True where a contact is reported."""
    return bool(contact(log, array).any())


def loses(log: Log, array: Array) -> bool:
    """Return True where a contact is reported that is over before the log is."""
    in_contact = contact(log, array)
    return bool(in_contact.any() and not in_contact[-1])


def periods_mm(log: Log, array: Array) -> list[float]:
    """Return the periods that are reported, in order; `--sliding --speed V --max-tilt 10`."""
    texture = {"speed_mm_s": log.speed_mm_s, "max_tilt_deg": _TILT_DEG}
    params = DetectParams.model_validate({"texture": texture})
    found = _events(log, array, params, ("texture",), KnownSliding())
    answers = [event for event in found if isinstance(event, TextureEvent)]
    return [event.period_mm for event in answers if event.status in ("ok", "period-only")]


def _events(
    log: Log, array: Array, params: DetectParams, topics: Sequence[str], sliding: KnownSliding | None = None
) -> list[Event]:
    suite = TunedSuite(array, params, lambda a, p: build_suite(a, p, sliding=sliding, topics=tuple(topics)))
    blocks = to_blocks(log.time_s, log.readings, None, array.in_range(log.readings))
    return [event for item in blocks for event in suite.process(item)]


class ForceErrors(NamedTuple):
    """Errors of the forces of a log by axis, rms over its range, in folds that leave out whole contacts."""

    ours: FloatArray
    ridge: FloatArray  # regression in the same folds
    inside: FloatArray  # part of the 90 % intervals that hold the force


def forces(log: Log, array: Array, ridge: Ridge | None, *, are_poses: bool) -> ForceErrors | None:
    """Calibrate as `tactiled calibrate` does, and judge the folds; None where it refuses.

    A ridge returns the rms errors (axes,) of a rule; without it, those of ridge with squares stand.
    """
    assert log.forces is not None
    values = np.full((len(log.time_s), 6), np.nan)
    values[:, :3] = log.forces
    table = ReferenceTable(log.time_s, values)
    try:
        study = calibrate(array, log.time_s, log.readings, table, log.name, are_poses=are_poses)
    except DataError:
        return None
    used = [axis for axis in study.used if axis < 3]
    spread = np.ptp(log.forces[:, used], axis=0)
    left_out = study.left_out[:, used]
    return ForceErrors(
        ours=np.sqrt((left_out**2).mean(axis=0)) / spread,
        ridge=(ridge(log, study.time_s, study.reference, used) if ridge else study.baseline[used]) / spread,
        inside=(np.abs(left_out) < _Z90 * study.sd[:, used]).mean(axis=0),
    )
