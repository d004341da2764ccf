"""Named settings: which detectors a pipeline runs on every block.

To add one: write its module beside the others, hold it to `tests/detect`'s contract, and name it here.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

from pydantic import Field, model_validator

from tactiled.array import Array
from tactiled.detect.base import Detector
from tactiled.detect.grooves.estimator import JointParams, JointTexture
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.slip.coherent import SETTINGS, CoherentParams, CoherentSlip
from tactiled.detect.wang2019.slip import SlipParams, WaveletSlip
from tactiled.detect.wang2019.texture import PaperTexture, TextureParams
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
    wang2019: Wang2019Params = Wang2019Params()

    @model_validator(mode="before")
    @classmethod
    def _as_the_setting_says(cls, document: Any) -> Any:
        """Keys of `slip` that are left out come from the setting."""
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
        """Where the parameters of the setting are: a dotted prefix, empty for the tables of this model."""
        return "wang2019." if self.setting == "wang2019" else ""


def _over(table: dict[str, Any], given: Any) -> Any:
    """`table` with what is given in its place, table by table; what is no table stays as it is given."""
    if not isinstance(given, Mapping):
        return given
    merged = {k: _over(table[k], v) if isinstance(table.get(k), dict) else v for k, v in given.items()}
    return table | merged


class SlipDetector(Detector, Protocol):
    """Contact and slip events."""

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        ...


class TextureEstimator(Protocol):
    """Texture events, gated by the events of the slip detector."""

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        ...

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Sliding speed that holds from a scan on."""
        ...

    def process(self, item: ScanBlock | Gap, slip: Sequence[Event] = ()) -> list[Event]:
        """Events that the item completes, given what the slip detector said of it."""
        ...


class DetectorPair:
    """A slip detector, and a texture estimator that gets its events with each item; a `Detector`.

    Parameters
    ----------
    slip : SlipDetector
    texture : TextureEstimator
    """

    def __init__(self, slip: SlipDetector, texture: TextureEstimator) -> None:
        self._slip = slip
        self.texture = texture

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._slip.reset()
        self.texture.reset()

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._slip.contact_state

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Events that the item completes, in the order of their evidence, however scans were chunked."""
        events = self._slip.process(item)
        texture = self.texture.process(item, events)
        # The sort is stable: slip before texture.
        return sorted([*events, *texture], key=lambda event: event.evidence_s)


class Suite(Detector, Protocol):
    """The detectors of a setting as one detector."""

    @property
    def texture(self) -> TextureEstimator | None:
        """Estimator that takes the sliding speed; None where no detector uses it."""
        ...


class BridgedSuite(GapBridge):
    """Detectors behind a bridge over short gaps; a `Suite`."""

    def __init__(self, methods: DetectorPair) -> None:
        super().__init__(methods)
        self.texture: TextureEstimator | None = methods.texture


def build_suite(array: Array, params: DetectParams) -> Suite:
    """Make the detectors of a setting, with short gaps bridged."""
    return BridgedSuite(build_methods(array, params))


def build_methods(array: Array, params: DetectParams) -> DetectorPair:
    """Make the detectors of a setting without the bridge: every gap reaches them."""
    if params.setting == "wang2019":
        published = params.wang2019
        return DetectorPair(WaveletSlip(array, published.slip), PaperTexture(array, published.texture))
    return DetectorPair(CoherentSlip(array, params.slip), JointTexture(array, params.texture))
