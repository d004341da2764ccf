"""Named settings: which detectors a pipeline runs on every block.

To add one: write its module beside the others, hold it to `tests/detect`'s contract, and name it here.
"""

from typing import Literal, Protocol

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.bridge import Bridge
from tactiled.detect.wang2019 import Wang2019, Wang2019Params
from tactiled.tomlfile import Params

Setting = Literal["wang2019"]


class DetectParams(Params):
    """Which detectors run, and their parameters."""

    setting: Setting = Field(default="wang2019", description="wang2019: the published methods, as published")
    wang2019: Wang2019Params = Wang2019Params()


class Suite(Detector, Protocol):
    """The detectors of a setting, as one."""

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Sliding speed that holds from a scan on."""
        ...


class Bridged(Bridge):
    """A suite that is spared short gaps."""

    def __init__(self, suite: Suite) -> None:
        super().__init__(suite)
        self.set_speed = suite.set_speed


def build_suite(array: Array, params: DetectParams) -> Suite:
    """The detectors of a setting, as one."""
    return Bridged({"wang2019": lambda: Wang2019(array, params.wang2019)}[params.setting]())
