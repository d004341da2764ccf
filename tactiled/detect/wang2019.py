"""The published methods in their order: contact, slip, texture. One detector for the pipeline."""

from pydantic import Field

from tactiled.array import Array
from tactiled.detect.slip_wavelet import SlipParams, WaveletSlip
from tactiled.detect.texture_paper import PaperTexture, TextureParams
from tactiled.events.types import ContactState, Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock
from tactiled.tomlfile import Params


class Wang2019Params(Params):
    """Parameters of the published methods."""

    slip: SlipParams = Field(default=SlipParams(), description="contact gate and the 0.002 V rule")
    texture: TextureParams = Field(default=TextureParams(), description="the flow chart for grooves")


class Wang2019:
    """Contact, slip and texture events of Wang, Chen, Mei 2019.

    The slip detector owns the contact's state; the texture estimator is told what slip said of each item.

    Parameters
    ----------
    array : Array
    params : Wang2019Params
    """

    def __init__(self, array: Array, params: Wang2019Params | None = None) -> None:
        params = params or Wang2019Params()
        self._slip = WaveletSlip(array, params.slip)
        self._texture = PaperTexture(array, params.texture)

    def reset(self) -> None:
        """Forget everything seen; keep the parameters."""
        self._slip.reset()
        self._texture.reset()

    @property
    def contact_state(self) -> ContactState:
        """State of the contact after the last scan."""
        return self._slip.contact_state

    def set_speed(self, speed_mm_s: float, from_index: int) -> None:
        """Sliding speed that holds from a scan on."""
        self._texture.set_speed(speed_mm_s, from_index)

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        """Events that the item completes, in the order of their evidence, however scans were chunked."""
        events = self._slip.process(item)
        return sorted([*events, *self._texture.process(item, events)], key=_evidence_s)


def _evidence_s(event: Event) -> float:
    """Instant of the scan that completed an event (the sort is stable: slip before texture)."""
    return event.detected_s if isinstance(event, SlipEvent) else event.time_s
