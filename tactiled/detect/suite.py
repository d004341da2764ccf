"""Detectors under one name: what a pipeline runs on every block, and the order in which they see it.

To add a detector: write its module beside the others, hold it to `tests/detect`'s contract, and name it here.
"""

from typing import Literal

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.slip_wavelet import SlipParams, WaveletSlip
from tactiled.detect.texture_paper import PaperTexture, TextureParams
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

Setting = Literal["wang2019"]
SETTINGS: tuple[Setting, ...] = ("wang2019",)


class DetectParams(Params):
    """Which detectors run, and their parameters."""

    setting: Setting = Field(default="wang2019", description="wang2019: the published methods, as published")
    slip: SlipParams = SlipParams()
    texture: TextureParams = TextureParams()


class PaperSuite:
    """The methods of Wang, Chen, Mei 2019: contact and slip first, texture gated by slip."""

    def __init__(self, array: Array, params: DetectParams) -> None:
        self._slip = WaveletSlip(array, params.slip)
        self._texture = PaperTexture(array, params.texture)

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._slip.reset()
        self._texture.reset()

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Events that `item` completes, in the order of their evidence, however scans were chunked."""
        slip = self._slip.process(item)
        return sorted([*slip, *self._texture.process(item, slip)], key=_evidence_s)


def _evidence_s(event: Event) -> float:
    """Instant of the scan that completed an event (the sort is stable: slip before texture)."""
    return event.detected_s if isinstance(event, SlipEvent) else event.time_s


def build_suite(array: Array, params: DetectParams) -> Detector:
    """The detectors of a setting."""
    return {"wang2019": PaperSuite}[params.setting](array, params)
