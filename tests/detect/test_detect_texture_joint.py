"""The joint estimator online: the contract of every detector, when it answers, and what it refuses."""

import numpy as np
import pytest
from hypothesis import given, settings
from touches import Touch, pieces, splits, textures

from tactiled.array import Array, load_array
from tactiled.detect.slip_wavelet import WaveletSlip
from tactiled.detect.texture_joint import JointParams, JointTexture
from tactiled.events.types import Event, TextureEvent
from tactiled.samples.block import Gap, ScanBlock

ARRAY = load_array("wang2019-3x3")
SKEW_S = np.arange(36) * 2e-4
PERIOD_MM, ANGLE_DEG, SPEED_MM_S = 1.2, 20.0, 2.0
TOUCH = Touch(grooves=(PERIOD_MM, ANGLE_DEG), speed_mm_s=SPEED_MM_S, slide_s=3.0, stop_s=9.0)


class Slid:
    """Slip and joint texture as one detector."""

    def __init__(self, params: JointParams, array: Array = ARRAY) -> None:
        self.slip = WaveletSlip(array)
        self.texture = JointTexture(array, params)

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        events = self.slip.process(item)
        return [*events, *self.texture.process(item, events)]

    def reset(self) -> None:
        self.slip.reset()
        self.texture.reset()


def answers(params: JointParams, block: ScanBlock) -> list[TextureEvent]:
    return textures(Slid(params).process(block))


@pytest.mark.parametrize("speed_mm_s", [0.0, SPEED_MM_S])
def test_any_chunking_gives_the_same_bits(speed_mm_s: float) -> None:
    block = TOUCH.block(ARRAY, 100.0, SKEW_S)
    params = JointParams(preset="quick", speed_mm_s=speed_mm_s, hop_s=1.0)
    whole = answers(params, block)
    assert any(e.status == "ok" for e in whole)

    @given(splits(len(block)))
    @settings(max_examples=6, deadline=None)
    def same(cuts: list[int]) -> None:
        detector = Slid(params)
        assert textures([e for part in pieces(block, cuts) for e in detector.process(part)]) == whole

    same()


@pytest.mark.parametrize("speed_mm_s", [0.0, SPEED_MM_S])
def test_answers_within_three_seconds_and_holds_its_sigmas(speed_mm_s: float) -> None:
    events = answers(JointParams(preset="quick", speed_mm_s=speed_mm_s), TOUCH.block(ARRAY, 100.0, SKEW_S))
    first = next(e for e in events if e.status == "ok")
    assert first.time_s - (100.0 + TOUCH.slide_s) < 3.0
    for event in (first, *(e for e in events if e.status == "ok")):
        assert event.period_mm == pytest.approx(PERIOD_MM, abs=5 * event.period_sd_mm)
        assert event.angle_deg == pytest.approx(ANGLE_DEG, abs=5 * event.angle_sd_deg)
        assert event.period_sd_mm <= 0.02
        assert event.angle_sd_deg <= 1.0
        assert event.speed_source == ("given" if speed_mm_s else "estimated")
        assert event.speed_mm_s == pytest.approx(SPEED_MM_S, rel=0.02)
