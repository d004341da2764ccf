"""Blocks and detectors refuse parts that do not fit: compiled code would read beyond them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.signal.quantise import Quantiser
from tactiled.errors import ContractError
from tactiled.samples.block import ScanBlock, regular_block

ARRAY = load_array("wang2019-3x3")
BLOCK = regular_block(np.zeros((5, 36)), 100.0)


@pytest.mark.parametrize(
    "change",
    [
        {"volts": np.zeros((5, 35))},
        {"volts": np.zeros(5), "valid": np.ones(5, dtype=np.bool_)},
        {"channel_offset_s": np.zeros(1)},
        {"channel_offset_s": np.zeros(0)},
        {"valid": np.ones((5, 36), dtype=np.int64)},
        {"late": np.zeros(4, dtype=np.bool_)},
        {"index": BLOCK.index * 2},  # it straddles gaps
    ],
)
def test_a_block_whose_parts_do_not_fit_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ContractError):
        replace(BLOCK, **change)


@pytest.mark.parametrize("channels", [1, 35, 37])
@pytest.mark.parametrize(
    "process",
    [
        lambda block: GripDetector(ARRAY).process(block),
        lambda block: Quantiser(ARRAY).process(block),
    ],
    ids=["grip", "readings"],
)
def test_a_block_of_another_array_is_refused(channels: int, process: Callable[[ScanBlock], object]) -> None:
    with pytest.raises(ContractError, match=str(channels)):
        process(regular_block(np.zeros((5, channels)), 100.0))


def test_blocks_may_be_of_any_layout_in_memory() -> None:
    rng = np.random.default_rng(0)
    volts = rng.uniform(0.5, 1.0, (40, 72))
    dense = regular_block(np.ascontiguousarray(volts[:, ::2]), 100.0)
    strided = replace(dense, volts=volts[:, ::2], valid=np.asfortranarray(dense.valid))
    assert GripDetector(ARRAY).process(strided) == GripDetector(ARRAY).process(dense)
