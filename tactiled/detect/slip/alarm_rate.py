"""Relation of the false-alarm rate to the growth of shear that is reported.

A hand that moves loads the skin, and friction is not known beforehand, so the first part of a load that will
hold looks like the first part of a slip. The required growth of shear decides how often that is reported:
`SHEAR` over `PER_HOUR` is the measured curve. It was measured on the families without slip
(`emulator.scene.families`, all of equal duration, nothing announced, at 0.3 and 3 mV of noise, seeds 1001 to
1024, which no bench reports); ``python -m bench.slip.hand`` repeats the measurement. A calmer hand raises
fewer alarms: `tactiled tune` measures them.

Rates above the highest gain nothing, because any growth of shear is then reported and noise limits the
detection. Nor do rates below the lowest: a skin with a friction coefficient of 0.3 slips as a whole when
shear has grown to 0.57 of the pressure.
"""

import numpy as np

# Rates an hour, and the growth of shear over pressure that raises them.
PER_HOUR = (2.52, 8.11, 19.6, 36.4, 68.2, 115.0, 161.0, 206.0, 228.0, 252.0)
SHEAR = (0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1, 0.05, 0.02, 0.005)
# Part of the permitted rate that noise alone may use. At the rate of `fast` that is less than one alarm an
# hour for a hand whose motion is all announced.
NOISE_PART = 0.003


def shear_at(per_hour: float) -> float:
    """Return the growth of shear over pressure to wait for, by log-linear interpolation."""
    return float(np.exp(np.interp(np.log(per_hour), np.log(PER_HOUR), np.log(SHEAR))))


def rate_at(shear: float) -> float:
    """Return the false alarms per hour of an unannounced moving hand at a growth of shear over pressure."""
    return float(np.exp(np.interp(-np.log(shear), -np.log(SHEAR), np.log(PER_HOUR))))
