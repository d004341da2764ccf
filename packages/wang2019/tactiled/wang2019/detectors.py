"""The published methods as detectors of the setting ``wang2019``."""

from tactiled.array import Array
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.suite import DetectorFactories, DetectParams
from tactiled.detect.worker import Worker
from tactiled.wang2019.grooves import GrooveLimits
from tactiled.wang2019.slip import WaveletSlip
from tactiled.wang2019.texture import PaperTexture

_SHIPPED = JointParams()


def _slip(array: Array, _params: DetectParams) -> WaveletSlip:
    return WaveletSlip(array)


def _texture(array: Array, params: DetectParams, _worker: Worker, is_given: bool) -> PaperTexture:
    texture = params.texture
    return PaperTexture(
        array, texture.speed_mm_s, texture.speed_sd_mm_s, texture.direction_deg, is_given, _limits(texture)
    )


def _limits(texture: JointParams) -> GrooveLimits:
    """Return the limits of the paper, replaced by those that differ from the defaults of the joint estimator.

    A recording lists every key, whether it was configured or not: only the values show which were.
    """
    paper = GrooveLimits()
    low_mm, most_deg = texture.min_period_mm, texture.max_tilt_deg
    return GrooveLimits(
        min_period_mm=paper.min_period_mm if low_mm == _SHIPPED.min_period_mm else low_mm,
        max_angle_deg=paper.max_angle_deg if most_deg == _SHIPPED.max_tilt_deg else most_deg,
    )


DETECTORS = DetectorFactories(
    slip=_slip,
    texture=_texture,
    reads=frozenset(
        {
            *("texture.speed_mm_s", "texture.speed_sd_mm_s", "texture.direction_deg"),
            *("texture.min_period_mm", "texture.max_tilt_deg"),
            "grip.publish",  # there are no grip messages, whatever it says
        }
    ),
    needs_shear=True,
    unit="V",
)
