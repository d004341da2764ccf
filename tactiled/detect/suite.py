"""Named settings: which detectors a pipeline runs on every block.

To add one: write its module beside the others, hold it to `tests/detect`'s contract, and name it here.
"""

from typing import Literal

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.wang2019 import Wang2019, Wang2019Params
from tactiled.tomlfile import Params

Setting = Literal["wang2019"]


class DetectParams(Params):
    """Which detectors run, and their parameters."""

    setting: Setting = Field(default="wang2019", description="wang2019: the published methods, as published")
    wang2019: Wang2019Params = Wang2019Params()


def build_suite(array: Array, params: DetectParams) -> Detector:
    """The detectors of a setting, as one."""
    return {"wang2019": lambda: Wang2019(array, params.wang2019)}[params.setting]()
