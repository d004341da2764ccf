"""Injection of slip onsets of known shape into recordings with real noise.

The response of a taxel that begins to slip follows Mindlin's curve (J. Appl. Mech. 16, 1949): at constant
speed the tangential response grows as ``1 - (1 - t / rise_s)^(3/2)`` and stays; its final value is a fraction
of the taxel's pressure. Not modelled: taxels that slip one after the other, changing pressure, saturated
sides. The latencies are therefore lower bounds for the given noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tactiled.array import Array, FloatArray
from tactiled.detect.slip.detector import CoherentParams, CoherentSlip
from tactiled.errors import ConfigError
from tactiled.events.types import SlipEvent
from tactiled.samples.block import ScanBlock
from tactiled.tune.hold import Recording, touching

_LEAD_S = 2.0  # the detector's noise floor settles
_AFTER_S = 0.5  # a slip reported later than this after gross slip counts as missed
_TRIES = 20  # the median is then between the 6th and the 15th of them, at 95 %
# The golden section spreads any number evenly: onsets between two scans, directions around the circle.
_GOLDEN = 0.618


@dataclass(frozen=True)
class InjectedOnset:
    """Parameters of an injected slip onset.

    Attributes
    ----------
    shear : float
        Final shear over pressure, both in volts.
    rise_s : float
        Time from onset to gross slip.
    """

    shear: float
    rise_s: float


def slide(array: Array, volts: FloatArray, share: FloatArray, direction_deg: float) -> FloatArray:
    """Add shear to readings (n, channels): `share` (n,) of each taxel's pressure, along a direction.

    Raises
    ------
    ConfigError
        The array cannot sense tangential load.
    """
    theta = np.deg2rad(direction_deg)
    along = np.array([np.cos(theta), np.sin(theta)])
    normal = array.normal_weights()
    pressure = np.nan_to_num(volts) @ normal.T  # NaN channels must not affect others
    if array.has_shear:
        weights = np.einsum("d,dtc->tc", along, array.shear_weights())
        # The smallest change of the channels that gives one unit of shear.
        return np.asarray(volts + share[:, np.newaxis] * (pressure @ (weights / _squares(weights))))
    across = along @ np.stack([array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()])
    reach = np.hypot(array.x_mm - array.x_mm.mean(), array.y_mm - array.y_mm.mean()).mean()
    if not np.any(across):
        raise ConfigError(
            "array",
            [f"{array.name} cannot measure tangential load: slip needs more than one pressure channel"],
        )
    # A tilted load: a first moment of pressure, which `detect.slip.response` takes for shear.
    lean = across / reach / np.mean((across / reach) ** 2)
    change = share[:, np.newaxis] * pressure.mean(axis=1, keepdims=True) * lean
    return np.asarray(volts + change @ np.sign(normal))


def _squares(weights: FloatArray) -> FloatArray:
    """Squared norm (taxels, 1) of each taxel's weights; one where all are zero."""
    squares = (weights**2).sum(axis=1, keepdims=True)
    return np.where(squares > 0, squares, 1.0)


def latencies(recording: Recording, params: CoherentParams, onset: InjectedOnset) -> list[float]:
    """Latencies (s) from each injected onset to the end of the detecting scan; inf where missed.

    Onsets during an existing alarm are skipped.
    """
    found = []
    for number, (block, scan) in enumerate(_places(recording, onset)):
        part = _GOLDEN * number % 1
        begin_s = float(block.time_s[scan]) + part / block.rate_hz
        slipping = _with_onset(recording.array, block, begin_s, onset, 360 * part)
        slips = [
            e for e in CoherentSlip(recording.array, params).process(slipping) if isinstance(e, SlipEvent)
        ]
        before = [e.state for e in slips if e.detected_s <= begin_s]
        if before and before[-1] == "onset":
            continue
        detected_s = [
            e.detected_s for e in slips if e.state == "onset" and e.valid and e.detected_s > begin_s
        ]
        span_s = float(block.channel_offset_s.max())
        found.append(detected_s[0] - begin_s + span_s if detected_s else np.inf)
    return found


def _places(recording: Recording, onset: InjectedOnset) -> Iterator[tuple[ScanBlock, int]]:
    """Yield evenly spread stretches of contact, and the scan of each at which the onset begins."""
    windows = [(block, *_windows(block, recording.array, onset)) for block in recording.blocks]
    total = sum(len(starts) for _, starts, _ in windows)
    for k in np.unique(np.linspace(0, total - 1, _TRIES).astype(int)) if total else ():
        for block, starts, length in windows:
            if k < len(starts):
                yield block[starts[k] : starts[k] + length], round(_LEAD_S * block.rate_hz)
                break
            k -= len(starts)


def _windows(block: ScanBlock, array: Array, onset: InjectedOnset) -> tuple[NDArray[np.int64], int]:
    """First scans of all windows in contact throughout, and the window length."""
    length = round((_LEAD_S + onset.rise_s + _AFTER_S) * block.rate_hz)
    off = np.concatenate([[0], np.cumsum(~touching(block, array))])
    return np.flatnonzero(off[length:] == off[: max(len(off) - length, 0)]), length


def _with_onset(
    array: Array, block: ScanBlock, begin_s: float, onset: InjectedOnset, direction_deg: float
) -> ScanBlock:
    """Inject an onset, evaluated for all channels at the start of the scan, which is conservative."""
    travel = np.clip((block.time_s - begin_s) / onset.rise_s, 0.0, 1.0)
    share = onset.shear * (1 - (1 - travel) ** 1.5)
    return replace(block, volts=slide(array, block.volts, share, direction_deg))
