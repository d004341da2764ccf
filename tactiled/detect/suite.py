"""Detectors that run on every block, by the name of the setting.

To add a detector, write its module beside the others and enter it in `REGISTRY`. The contract test
(`tests/detect/test_detect_contract.py`) then holds it to the promises of `tactiled.detect.base`.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Protocol

from pydantic import Field, model_validator

from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.grip.detector import GripDetector, GripParams
from tactiled.detect.grooves.estimator import JointParams, JointTexture
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.slip.detector import SETTINGS, CoherentParams, CoherentSlip
from tactiled.detect.wang2019.slip import SlipParams, WaveletSlip
from tactiled.detect.wang2019.texture import PaperTexture, TextureParams
from tactiled.detect.worker import InPlace, Worker
from tactiled.events.types import ContactState, Event
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

Setting = Literal["fast", "balanced", "quiet", "wang2019"]


class Wang2019Params(Params):
    """Parameters of the published methods."""

    slip: SlipParams = Field(default=SlipParams(), description="contact gate and the 0.002 V rule")
    texture: TextureParams = Field(default=TextureParams(), description="the flow chart for grooves")


class DetectParams(Params):
    """Which detectors run, and their parameters."""

    setting: Setting = Field(
        default="balanced",
        description="how sure a slip must be; wang2019: the published methods, as published",
    )
    slip: CoherentParams = Field(default=CoherentParams(), description="left out: what the setting says")
    texture: JointParams = JointParams()
    grip: GripParams = GripParams()
    wang2019: Wang2019Params = Wang2019Params()

    @model_validator(mode="before")
    @classmethod
    def _as_the_setting_says(cls, document: Any) -> Any:
        """Complete the table `slip` with the values of the setting."""
        if not isinstance(document, Mapping):
            return document
        named = SETTINGS.get(str(document.get("setting", "balanced")))
        return (
            document
            if named is None
            else {**document, "slip": _over(named.model_dump(), document.get("slip", {}))}
        )

    @property
    def in_use(self) -> str:
        """Dotted prefix of the tables that the setting reads; empty for the tables of this model."""
        return "wang2019." if self.setting == "wang2019" else ""


def _over(table: dict[str, Any], given: Any) -> Any:
    """Merge nested tables: the values of `given` replace those of `table`.

    A `given` that is no table is returned unchanged, so that validation can refuse it.
    """
    if not isinstance(given, Mapping):
        return given
    merged = {k: _over(table[k], v) if isinstance(table.get(k), dict) else v for k, v in given.items()}
    return table | merged


class SlipDetector(Detector, Protocol):
    """Detector of contact and slip."""

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        ...


class TextureEstimator(Protocol):
    """Estimator of grooves, gated by the events of the slip detector."""

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        ...

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Set the sliding speed from scan `from_index` on."""
        ...

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Return the events that the item completes; `slip` has the slip events of the same item."""
        ...

    def expect_late_fit(self, due_index: int) -> None:
        """Treat the fit that is due at a scan as not ready, as it was in the live run."""
        ...

    def take_late_fits(self) -> list[int]:
        """Return the due scans of the fits that were not ready since the last call."""
        ...


class DetectorPair:
    """Slip detector and texture estimator as one `Detector`; the estimator is given the slip events.

    Parameters
    ----------
    slip : SlipDetector
    texture : TextureEstimator
    grip : Detector, optional
        Runs beside the two.
    """

    def __init__(self, slip: SlipDetector, texture: TextureEstimator, grip: Detector | None = None) -> None:
        self._slip = slip
        self.texture = texture
        self._grip = grip

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._slip.reset()
        self.texture.reset()
        if self._grip is not None:
            self._grip.reset()

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._slip.contact_state

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes, in order of their evidence for any chunking."""
        events = self._slip.process(item)
        texture = self.texture.process(item, events)
        grip = [] if self._grip is None else self._grip.process(item)
        # The sort is stable: slip before texture, and texture before grip.
        return sorted([*events, *texture, *grip], key=lambda event: event.evidence_s)


class Suite(Detector, Protocol):
    """Detectors of a setting as one detector."""

    @property
    def texture(self) -> TextureEstimator | None:
        """Estimator that takes the sliding speed; None where no detector uses it."""
        ...


class BridgedSuite(GapBridge):
    """`Suite` whose detectors are given interpolated scans in place of short gaps."""

    def __init__(self, methods: DetectorPair) -> None:
        super().__init__(methods)
        self.texture: TextureEstimator | None = methods.texture


class DetectorFactories(NamedTuple):
    """Constructors of the slip detector and the texture estimator that run together.

    Attributes
    ----------
    slip, texture : callable
        Make the detector for an array from the parameters of all detectors. The texture estimator may hand
        long computations to the worker.
    """

    slip: Callable[[Array, DetectParams], SlipDetector]
    texture: Callable[[Array, DetectParams, Worker], TextureEstimator]


_COHERENT = DetectorFactories(
    slip=lambda array, params: CoherentSlip(array, params.slip),
    texture=lambda array, params, worker: JointTexture(array, params.texture, worker),
)
_WANG2019 = DetectorFactories(
    slip=lambda array, params: WaveletSlip(array, params.wang2019.slip),
    texture=lambda array, params, _: PaperTexture(array, params.wang2019.texture),
)
REGISTRY: Mapping[Setting, DetectorFactories] = {
    "fast": _COHERENT,
    "balanced": _COHERENT,
    "quiet": _COHERENT,
    "wang2019": _WANG2019,
}
"""Detectors of each setting; settings that share detectors differ in their parameters."""


def build_suite(array: Array, params: DetectParams, worker: Worker | None = None) -> Suite:
    """Make the detectors of a setting, with short gaps interpolated."""
    return BridgedSuite(build_methods(array, params, worker))


def build_methods(array: Array, params: DetectParams, worker: Worker | None = None) -> DetectorPair:
    """Make the detectors of a setting without interpolation: every gap reaches them.

    Parameters
    ----------
    array : Array
    params : DetectParams
    worker : Worker, optional
        Takes long computations; without one they are computed in place.
    """
    factories = REGISTRY[params.setting]
    texture = factories.texture(array, params, worker or InPlace())
    grip = GripDetector(array, params.grip) if params.grip.enabled else None
    return DetectorPair(factories.slip(array, params), texture, grip)
