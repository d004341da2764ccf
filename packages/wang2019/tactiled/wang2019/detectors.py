"""The published methods as detectors of the setting ``wang2019``."""

from tactiled.array import Array
from tactiled.detect.suite import DetectorFactories, DetectParams
from tactiled.detect.worker import Worker
from tactiled.wang2019.slip import WaveletSlip
from tactiled.wang2019.texture import PaperTexture


def _slip(array: Array, _params: DetectParams) -> WaveletSlip:
    return WaveletSlip(array)


def _texture(array: Array, params: DetectParams, _worker: Worker, is_given: bool) -> PaperTexture:
    texture = params.texture
    return PaperTexture(array, texture.speed_mm_s, texture.speed_sd_mm_s, texture.direction_deg, is_given)


DETECTORS = DetectorFactories(
    slip=_slip,
    texture=_texture,
    reads=frozenset(
        {
            *("texture.speed_mm_s", "texture.speed_sd_mm_s", "texture.direction_deg"),
            "grip.publish",  # there are no grip messages, whatever it says
        }
    ),
    needs_shear=True,
    unit="V",
)
