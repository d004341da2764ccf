"""Detectors that run on every block, by the name of the setting.

The settings here share the contact filter and the groove estimator, and differ in probabilities. Another
distribution offers a setting of its own in the entry-point group `tactiled.detectors`, as
``SETTING = "MODULE:FACTORIES"`` with `DetectorFactories`. `tests/detect/test_detect_contract.py` holds each
of them to the promises of `tactiled.detect.base`.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple, Protocol

from pydantic import Field, field_validator, model_validator

from tactiled.array import Array
from tactiled.detect.base import ContactDetector, in_order
from tactiled.detect.contact.grip_detector import GripDetector, GripParams
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.grooves.estimator import JointTexture, WindowFit
from tactiled.detect.grooves.params import JointParams
from tactiled.detect.grooves.window_fits import fit_line, fit_wave, fit_wave_or_line
from tactiled.detect.signal.bridge import GapBridge
from tactiled.detect.signal.contact_gate import levels_fault
from tactiled.detect.signal.slip_gate import KnownSliding, KnownSlips
from tactiled.detect.sliding.sliding_detector import LOOKS_BACK_S, SlidingSlip
from tactiled.detect.worker import InPlace, Worker
from tactiled.errors import ConfigError
from tactiled.events.types import Event, GripEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params

DETECTED_TOPICS = ("slip", "contact", "grip", "texture")
GROUP = "tactiled.detectors"
_PUBLISHED = "wang2019"  # setting of a distribution of this repository


class DetectParams(Params):
    """Selection of the detectors that run, and their parameters."""

    setting: str = Field(
        default="balanced",
        description="fast, balanced or quiet: probabilities from which slip is reported, lower ones earlier "
        "and more often wrong; wang2019: the published methods, of tactiled-wang2019",
    )
    texture: JointParams = JointParams()
    grip: GripParams = GripParams()

    @field_validator("setting")
    @classmethod
    def _is_known(cls, setting: str) -> str:
        if setting not in SETTINGS and setting not in _packaged():
            if setting == _PUBLISHED:
                install = f"pip install 'tactiled[{_PUBLISHED}]', or ./packages/{_PUBLISHED} in a checkout"
                raise ValueError(f"needs tactiled-{_PUBLISHED}, which is not installed: {install}")
            raise ValueError(f"input should be one of {', '.join([*SETTINGS, _PUBLISHED])}")
        try:
            factories(setting)
        except (ImportError, AttributeError) as error:
            raise ValueError(f"its distribution cannot be loaded, install it again: {error}") from None
        return setting

    @model_validator(mode="before")
    @classmethod
    def _as_the_setting_says(cls, document: Any) -> Any:
        """Complete the table `grip` with the probabilities of the setting."""
        if not isinstance(document, Mapping):
            return document
        setting, given = str(document.get("setting", "balanced")), document.get("grip", {})
        if setting not in SETTINGS or not isinstance(given, Mapping):
            return document
        at = SETTINGS[setting]
        return {**document, "grip": {"incipient_p": at.incipient, "gross_p": at.gross, **given}}

    @property
    def is_packaged(self) -> bool:
        """True where the detectors are those of another distribution, which have no grip messages."""
        return self.setting not in SETTINGS

    def check_array(self, array: Array, source: str) -> None:
        """Refuse an array whose slips the setting cannot report.

        Raises
        ------
        ConfigError
            The setting needs shear and load, and the array does not measure both; or the unit of the array is
            not that of its thresholds; or a contact would be released above the level where it begins.
        """
        made = factories(self.setting)
        if made.needs_shear and not array.measures_ratio:
            fault = f"setting: {self.setting} needs channels of shear and load: {array.name} lacks them"
        elif made.unit not in ("", array.unit):
            fault = f"setting: {self.setting} has thresholds in {made.unit}: the readings of {array.name} are"
            fault += f" in {array.unit}"
        elif fault := levels_fault(array, self.grip.contact):
            fault = f"grip.contact: {fault}"
        else:
            return
        raise ConfigError(source, [f"detect.{fault}"])

    def unread(self) -> list[str]:
        """Return the keys that differ from their defaults but the setting ignores, as in ``grip.gross_p``."""
        reads = factories(self.setting).reads
        if reads is None:
            return []
        tables: dict[str, Params] = {"texture": self.texture, "grip": self.grip}
        return [
            f"{table}.{key}"
            for table, params in tables.items()
            for key, field in type(params).model_fields.items()
            if getattr(params, key) != field.default and f"{table}.{key}" not in reads
        ]


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


class Suite:
    """Slip detector and texture estimator, which is given the slips, as one `Detector`, over short gaps.

    Parameters
    ----------
    sliding : KnownSliding, optional
        Gives the estimator its slips, in place of the slip detector.

    Attributes
    ----------
    texture : TextureEstimator or None
        Takes the sliding speed.
    grip : GripDetector or None
        The slip detector, if friction can be stated to it, and the hand's own motion announced.
    """

    def __init__(
        self,
        slip: ContactDetector | None,
        texture: TextureEstimator | None,
        sliding: KnownSliding | None = None,
    ) -> None:
        self._bridge = GapBridge()
        self._slip, self.texture = slip, texture
        self._known = None if sliding is None else KnownSlips(sliding)
        self.grip = slip if isinstance(slip, GripDetector) else None

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        for part in (self._bridge, self._slip, self.texture, self._known):
            if part is not None:
                part.reset()

    @property
    def hidden_below(self) -> float:
        """Load that a contact must exceed, as the largest load of late has it: see `ContactDetector`."""
        return 0.0 if self._slip is None else self._slip.hidden_below

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Return the events that the item completes, in order of their evidence for any chunking."""
        seen = self._bridge.process(item)
        if seen is None:
            return []
        events = [] if self._slip is None else self._slip.process(seen)
        slips = events if self._known is None else self._known.process(seen)
        texture = [] if self.texture is None else self.texture.process(seen, slips)
        if isinstance(item, ScanBlock) and seen is not item:
            events = [event for event in events if not _is_interpolated(event, item)]
        return in_order(events, texture)


def _is_interpolated(event: Event, block: ScanBlock) -> bool:
    """Return True for the message of a scan before the block; the end of a contact is news."""
    return isinstance(event, GripEvent) and event.state != "none" and event.time_s < block.time_s[0]


class DetectorFactories(NamedTuple):
    """Constructors of the slip detector and the texture estimator that run together."""

    # slip, texture: make the detector for an array from the parameters of all detectors. The texture
    # estimator may hand long computations to the worker; the last argument says that sliding is known from
    # outside
    slip: Callable[[Array, DetectParams], ContactDetector]
    texture: Callable[[Array, DetectParams, Worker, bool], TextureEstimator]
    # keys of `DetectParams` that these detectors read, as in "texture.speed_mm_s"; None: all
    reads: Collection[str] | None = None
    needs_shear: bool = False  # slips are reported of arrays with shear and load only
    unit: str = ""  # of the thresholds of slip, which other arrays do not have; empty: they are relative


# choice: times the longest window of a slide: 32 s hold eight periods of 20 mm at 5 mm/s. A log waits for
# them, a robot does not; and 2,000 channels at 100 Hz take 115 MB.
_WIDEST = 4


def _joint_texture(array: Array, params: DetectParams, worker: Worker, is_given: bool) -> JointTexture:
    """Make the joint estimator, with the fit for what is known of places and direction.

    Arrays without shear channels never know the direction. Where sliding is given and the direction is not,
    arrays with shear channels could know it: a joint fit over all directions then takes longer than the hop.
    """
    fit: WindowFit = fit_wave
    if not array.has_places or (is_given and array.has_shear and params.texture.direction_deg is None):
        fit = fit_line
    elif is_given or not array.has_shear:
        fit = fit_wave_or_line
    texture = params.texture
    if is_given:  # from a file: no onset to stay clear of, and no worker to wait for
        texture = texture.model_copy(update={"settle_s": 0.0, "answer_after_s": 0.0})
    looks_back_s = 0.0 if is_given or array.has_shear else LOOKS_BACK_S
    widest = _WIDEST if is_given and fit is fit_line else 1
    return JointTexture(array, texture, worker, fit, looks_back_s, widest)


def _model_slip(array: Array, params: DetectParams) -> ContactDetector:
    """Make the slip detector of the contact filter, which needs shear over load, or what sliding shows."""
    if array.measures_ratio:
        return GripDetector(array, params.grip)
    return SlidingSlip(array, params.grip.contact)


_OWN = DetectorFactories(slip=_model_slip, texture=_joint_texture)


@cache
def _packaged() -> Mapping[str, Any]:
    """Return the entry points of the settings that other distributions offer, by name."""
    from importlib.metadata import entry_points  # takes 20 ms, and the settings here need none

    return {found.name: found for found in entry_points(group=GROUP)}


def factories(setting: str) -> DetectorFactories:
    """Return the constructors of the detectors of a setting."""
    if setting in SETTINGS:
        return _OWN
    found: DetectorFactories = _packaged()[setting].load()
    return found


def build_suite(
    array: Array,
    params: DetectParams,
    worker: Worker | None = None,
    sliding: KnownSliding | None = None,
    topics: Collection[str] = DETECTED_TOPICS,
) -> Suite:
    """Make the detectors of a setting.

    Parameters
    ----------
    worker : Worker, optional
        Takes long computations; without one they are computed in place.
    sliding : KnownSliding, optional
        Interval in which the skin is known to slide; the texture estimator then ignores slip events.
    topics : collection of str
        Topics that are asked for; detectors that none of them needs are left out.
    """
    make = factories(params.setting)
    texture: TextureEstimator | None = None
    if "texture" in topics:
        texture = make.texture(array, params, worker or InPlace(), sliding is not None)
    needs_slip = bool({"slip", "contact", "grip"} & set(topics)) or (texture is not None and sliding is None)
    return Suite(make.slip(array, params) if needs_slip else None, texture, sliding)
