"""Schemas of all requests of a client, checked before anything is done (protocols/control.md).

A request is one msgpack map. `parse` takes any bytes and returns a request, or the reason why they are not
one. Its time and memory are bounded by the limit of `LONGEST_BYTES` on the payload.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar, get_args

import msgpack
from pydantic import BeforeValidator, ConfigDict, Field

from tactiled import tomlfile
from tactiled.errors import ConfigError
from tactiled.tomlfile import Params

_Version = Literal[1]
(CONTROL_VERSION,) = get_args(_Version)
LONGEST_BYTES = 16 * 1024  # ten times a mark of 1000 characters with every threshold
MOST_VALUES = 256  # in a command: a quarter of a second at 1000 Hz, some 5 kB
_LONGEST_REASON = 500  # characters: a reason quotes the request
_SEQ_LIMIT = 2**63
T = TypeVar("T")

Values = Annotated[
    list[T], BeforeValidator(lambda value: value if isinstance(value, list) else [value]),
    Field(min_length=1, max_length=MOST_VALUES),
]  # fmt: skip
"""List of numbers, or one number in place of a list of one."""
Acceleration = Annotated[float, Field(ge=-1000, le=1000)]
# Seconds of a monotonic clock or since 1970, with a resolution of 2 microseconds; nanoseconds are refused.
SenderTime = Annotated[float, Field(ge=0, le=1e10)]


@dataclass(frozen=True)
class Requester:
    """Sender of a request, as far as the transport identifies it."""

    connection: str  # identifies the connection
    may_command: bool  # commands are accepted over this connection
    key: str = ""  # name of the CURVE key that the client proved to own; empty on endpoints without keys
    uid: int = -1  # user id from the kernel; -1 for a request that did not come over ipc
    address: str = ""  # address of a TCP peer; empty over ipc

    def __str__(self) -> str:
        if self.key:
            return f"key {self.key}"
        return f"uid {self.uid}" if self.uid >= 0 else f"an unknown user over TCP from {self.address}"


class Request(Params):
    """Fields of every request."""

    model_config = ConfigDict(strict=True)

    v: _Version = Field(description="version of this protocol")
    board: str = Field(
        default="",
        max_length=64,
        description="serial number of the board; left out or empty: the only one that the daemon reads",
    )
    id: str = Field(
        min_length=1,
        max_length=64,
        description="chosen by the client, echoed in the reply",
    )
    do: str
    who: str = Field(default="", max_length=64, description="how the client calls itself, for the record")


class State(Request):
    """Request for the newest message of each topic, and the settings."""

    do: Literal["state"]


class Events(Request):
    """Request for messages of one topic, by sequence number."""

    do: Literal["events"]
    board: str = Field(max_length=64, description="as in the messages; empty for a board unknown")
    topic: str = Field(max_length=64, description="slip, texture, ...")
    first_seq: int = Field(ge=0, lt=_SEQ_LIMIT, description="first number wanted")
    end_seq: int | None = Field(
        default=None, ge=0, lt=_SEQ_LIMIT, description="first number not wanted; left out: all"
    )


class CommandRequest(Request):
    """Request that changes something."""

    @property
    def arguments(self) -> dict[str, Any]:
        """Fields of the command, without those of every request."""
        return self.model_dump(exclude={"v", "id", "who", "do", "board"}, exclude_none=True)


class Tare(CommandRequest):
    """Take the present readings as zero."""

    do: Literal["tare"]
    force: bool = Field(default=False, description="although something is in contact or still moves")


class Speed(CommandRequest):
    """Set the sliding speed, for texture."""

    do: Literal["speed"]
    speed_mm_s: float = Field(ge=0, le=1000, description="0: not known")


class StatedFriction(CommandRequest):
    """State the friction of what is held next."""

    do: Literal["friction"]
    value: float = Field(
        ge=0.01, le=100, description="shear over load at gross slip, in units of the readings"
    )
    sd: float = Field(default=0.1, ge=0, le=1, description="standard deviation of its logarithm; 0.1: 10 %")


class ObjectChanged(CommandRequest):
    """Forget friction, stated or learnt: another object is held next."""

    do: Literal["object-changed"]


class Motion(CommandRequest):
    """Announce the hand's own motion, at 10 to 1000 Hz."""

    do: Literal["motion"]
    acceleration_m_s2: Values[Acceleration] = Field(
        description="of the hand minus that of gravity, against the object's pull: 9.81 at rest; or a list"
    )
    time_s: Values[SenderTime] | None = Field(
        default=None,
        description="instant of each value in your own clock; left out: one value, from its arrival on",
    )
    sent_s: SenderTime | None = Field(
        default=None, description="your clock when you sent the command; with time_s only"
    )


class Inhibit(CommandRequest):
    """Publish slips that begin in the next seconds as suppressed, because the hand itself moves."""

    do: Literal["inhibit"]
    duration_s: float = Field(ge=0, le=60, description="from now; 0 ends it")


class ExpectLoadChange(CommandRequest):
    """Publish incipient slips of the next seconds as suppressed, because a load is lifted or set down."""

    do: Literal["expect-load-change"]
    duration_s: float = Field(ge=0, le=60, description="from now; 0 ends it")


class Thresholds(CommandRequest):
    """Set parameters of the detectors, by the names of the configuration under ``[detect]``."""

    do: Literal["thresholds"]
    values: dict[Annotated[str, Field(min_length=1, max_length=64)], float] = Field(
        min_length=1, max_length=32, description="such as grip.incipient_p = 0.5"
    )


class Record(CommandRequest):
    """Start or stop the recording."""

    do: Literal["record"]
    on: bool


class Mark(CommandRequest):
    """Add a note to the events and the recording."""

    do: Literal["mark"]
    text: str = Field(min_length=1, max_length=1000)


_KINDS: tuple[type[Request], ...] = (State, Events, *CommandRequest.__subclasses__())
REQUESTS: dict[str, type[Request]] = {
    get_args(kind.model_fields["do"].annotation)[0]: kind for kind in _KINDS
}
"""All requests, by the name in `do`."""


@dataclass(frozen=True)
class Bad:
    """Payload that is not a request: the reason, and the fields that could be read."""

    reason: str
    id: str = ""
    do: str = ""


def parse(payload: bytes) -> Request | Bad:
    """Return the request, or the reason why `payload` is not one; never raises."""
    if len(payload) > LONGEST_BYTES:
        return Bad(f"request of {len(payload)} bytes: at most {LONGEST_BYTES}")
    try:
        document = msgpack.unpackb(payload)
    except Exception as error:  # msgpack raises half a dozen kinds of exception for invalid bytes
        return Bad(f"not msgpack ({type(error).__name__})")
    if not isinstance(document, dict) or not all(isinstance(key, str) for key in document):
        return Bad("not a map with string keys")
    asked, do = document.get("id"), document.get("do")
    id_ = asked if isinstance(asked, str) and len(asked) <= 64 else ""
    if not isinstance(do, str) or do not in REQUESTS:
        return Bad(f"do: {do!r:.40} is none of {', '.join(REQUESTS)}", id_)
    version = document.get("v")
    if type(version) is not int or version != CONTROL_VERSION:
        return Bad(f"v: {version!r:.20} is no version of this daemon's, which is {CONTROL_VERSION}", id_, do)
    try:
        return tomlfile.parse(document, REQUESTS[do], "")
    except (ConfigError, RecursionError) as error:
        faults = "; ".join(error.faults) if isinstance(error, ConfigError) else "nested too deeply"
        return Bad(faults[:_LONGEST_REASON], id_, do)
