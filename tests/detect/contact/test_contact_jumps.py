"""Channels that jump, and those that do not."""

from array import array

import numpy as np
import pytest
from numpy.typing import NDArray

from tactiled.array import FloatArray, load_array
from tactiled.detect.signal.front_end import Jumps

ARRAY = load_array("wang2019-3x3")
OWN = np.arange(9)[:, np.newaxis] == ARRAY.channel_taxel
LOADS, SD = np.ones(9), np.full(36, 1e-4)


class Gate:
    """Readings of a contact whose press is over."""

    def __init__(self, volts: FloatArray) -> None:
        self._jumps = Jumps(ARRAY)
        self._jumps.take(array("d", volts), 0, array("d", LOADS), array("d", SD), False)

    def take(self, volts: FloatArray, loads: FloatArray, sd: FloatArray) -> NDArray[np.bool_] | None:
        """Return the channels that jump, None without any."""
        self._jumps.take(array("d", volts), 0, array("d", loads), array("d", sd), True)
        found = np.array(self._jumps.found, dtype=np.bool_)
        return found if found.any() else None

    @property
    def accepted(self) -> list[float]:
        return list(self._jumps.accepted)


def gate(volts: FloatArray) -> Gate:
    return Gate(volts)


@pytest.mark.parametrize(("taxels", "jumps"), [(1, True), (3, True), (4, False), (9, False)])
def test_channels_jump_while_most_taxels_stay(taxels: int, jumps: bool) -> None:
    """Of four taxels in nine that move at once, each with all its sides, nobody knows that they do not."""
    volts = np.ones(36)
    moved = volts + 0.5 * OWN[:taxels].any(axis=0)
    found = gate(volts).take(moved, LOADS, SD)
    assert (found is not None) == jumps
    if found is not None:
        np.testing.assert_array_equal(found, OWN[:taxels].any(axis=0))


def test_one_side_of_many_taxels_is_no_jump_of_channels() -> None:
    moved = np.ones(36)
    moved[::4] += 0.5  # one channel of each taxel: the whole pad is pushed
    assert gate(np.ones(36)).take(moved, LOADS, SD) is None


def test_a_channel_that_jumped_keeps_its_reading_until_it_is_back_and_one_scan_more() -> None:
    volts = np.ones(36)
    one = gate(volts)
    jumped = volts.copy()
    jumped[5] = 2.0
    for _ in range(3):
        found = one.take(jumped, LOADS, SD)
        assert found is not None
        assert np.flatnonzero(found).tolist() == [5]
        assert one.accepted[5] == 1.0
    found = one.take(volts, LOADS, SD)
    assert found is not None  # what came back is not believed at once
    assert one.take(volts, LOADS, SD) is None


def test_small_changes_noise_and_moves_of_all_are_no_jumps() -> None:
    volts = np.ones(36)
    small = volts.copy()
    small[5] += 0.019  # of the mean load
    assert gate(volts).take(small, LOADS, SD) is None
    noisy = volts.copy()
    noisy[5] += 0.09
    assert gate(volts).take(noisy, LOADS, np.full(36, 0.01)) is None  # nine standard deviations
    pushed = volts + 0.02
    pushed[5] += 0.17  # less than ten times what the median taxel moves
    assert gate(volts).take(pushed, LOADS, SD) is None
    pushed[5] += 0.05
    assert gate(volts).take(pushed, LOADS, SD) is not None


def test_few_loaded_taxels_tell_nothing() -> None:
    volts, jumped = np.ones(36), np.ones(36)
    jumped[0] = 2.0
    loads = np.where(np.arange(9) < 3, 1.0, 0.05)
    assert gate(volts).take(jumped, loads, SD) is None
    assert gate(volts).take(jumped, np.where(np.arange(9) < 4, 1.0, 0.05), SD) is not None
