"""What a client may ask for: closed schemas, checked before anything is done (protocols/control.md).

A request is one msgpack map. `parse` takes any bytes and gives a request or the reason why they are none; a
payload of at most `LONGEST_BYTES` cannot make it work long or keep much.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

import msgpack
from pydantic import ConfigDict, Field

from tactiled import tomlfile
from tactiled.errors import ConfigError
from tactiled.tomlfile import Params

CONTROL_VERSION = 1
LONGEST_BYTES = 16 * 1024  # a mark of 1000 characters and every threshold there is fit ten times
_LONGEST_REASON = 500  # characters: reasons quote what was sent
_SEQ_LIMIT = 2**63

Id = Annotated[str, Field(min_length=1, max_length=64)]
Who = Annotated[str, Field(max_length=64)]
Session = Annotated[str, Field(max_length=64)]


@dataclass(frozen=True)
class Requester:
    """Who sent a request, as far as the transport tells.

    Attributes
    ----------
    connection : str
        Tells connections apart, except those of a client that chose a routing id (over ipc: of one process).
    key : str
        Name of the CURVE key that the client proved to own; empty on endpoints without keys.
    uid : int
        User, as the kernel says; -1 where it did not come over ipc.
    address : str
        Address of a TCP peer; empty where it came over ipc.
    may_command : bool
        Whether this is a way on which commands are taken.
    """

    connection: str
    key: str = ""
    uid: int = -1
    address: str = ""
    may_command: bool = True

    def __str__(self) -> str:
        if self.key:
            return f"key {self.key}"
        return f"uid {self.uid}" if self.uid >= 0 else f"an unknown user over TCP from {self.address}"


class Request(Params):
    """What every request carries."""

    model_config = ConfigDict(strict=True)

    v: Literal[1] = Field(description="version of this protocol")
    id: Id = Field(description="echoed in the reply; a command is done once for a session and an id")
    do: str
    session: Session = Field(
        default="",
        description="drawn at random by the client when it starts; left out: the connection is the session",
    )
    who: Who = Field(default="", description="how the client calls itself, for the record")


class State(Request):
    """The newest message of each topic, and the settings."""

    do: Literal["state"]


class Events(Request):
    """Messages of one topic, by number."""

    do: Literal["events"]
    board: str = Field(max_length=64, description="as in the messages; empty for a board unknown")
    topic: str = Field(max_length=64, description="slip, texture, ...")
    first_seq: int = Field(ge=0, lt=_SEQ_LIMIT, description="first number wanted")
    end_seq: int | None = Field(
        default=None, ge=0, lt=_SEQ_LIMIT, description="first number not wanted; left out: all"
    )


class CommandRequest(Request):
    """A request that changes something."""

    @property
    def arguments(self) -> dict[str, Any]:
        """What it says beside what every request says."""
        return self.model_dump(exclude={"v", "id", "who", "do", "session"}, exclude_none=True)


class Tare(CommandRequest):
    """Take the present readings as zero."""

    do: Literal["tare"]
    force: bool = Field(default=False, description="although something is in contact or still moves")


class Speed(CommandRequest):
    """Sliding speed, for texture."""

    do: Literal["speed"]
    speed_mm_s: float = Field(ge=0, le=1000, description="0: not known")


class Inhibit(CommandRequest):
    """Slips that begin in the next seconds are published as suppressed: the hand itself moves."""

    do: Literal["inhibit"]
    duration_s: float = Field(ge=0, le=60, description="from now; 0 ends it")


class ExpectLoadChange(CommandRequest):
    """Incipient slips of the next seconds are published as suppressed: a load is taken up or set down."""

    do: Literal["expect-load-change"]
    duration_s: float = Field(ge=0, le=60, description="from now; 0 ends it")


class Thresholds(CommandRequest):
    """Parameters of the detectors, by the names of the configuration under ``[detect]``."""

    do: Literal["thresholds"]
    values: dict[Annotated[str, Field(min_length=1, max_length=64)], float] = Field(
        min_length=1, max_length=32, description="such as slip.false_alarms_per_hour = 0.5"
    )


class Rate(CommandRequest):
    """Scans a second."""

    do: Literal["rate"]
    rate_hz: float = Field(gt=0, le=10_000)


class Record(CommandRequest):
    """Start or stop the recording."""

    do: Literal["record"]
    on: bool


class Mark(CommandRequest):
    """A note for whoever looks at the events later."""

    do: Literal["mark"]
    text: str = Field(min_length=1, max_length=1000)


REQUESTS: dict[str, type[Request]] = {
    get_args(kind.model_fields["do"].annotation)[0]: kind
    for kind in (State, Events, Tare, Speed, Inhibit, ExpectLoadChange, Thresholds, Rate, Record, Mark)
}


@dataclass(frozen=True)
class Bad:
    """No request: why, and what of its head could be read."""

    reason: str
    id: str = ""
    do: str = ""


def parse(payload: bytes) -> Request | Bad:
    """A request, or why it is none; never raises."""
    if len(payload) > LONGEST_BYTES:
        return Bad(f"request of {len(payload)} bytes: at most {LONGEST_BYTES}")
    try:
        document = msgpack.unpackb(payload)
    except Exception as error:  # msgpack raises half a dozen kinds, all of them for what is no msgpack
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
