"""Topics, services and discovery of one ROS 2 node over Cyclone DDS.

ROS 2 on DDS: a topic is ``rt/`` and its name; a node is an entry of ``ros_discovery_info`` with the ids of
its endpoints; a service is two topics, and each message of rmw_cyclonedds begins with 16 bytes that say which
request it belongs to. rmw_fastrtps writes those ids into RTPS instead, to which Cyclone DDS for Python gives
no access: services answer clients that run rmw_cyclonedds_cpp, topics reach every DDS.
"""

import logging
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl_types
from cyclonedds.internal import load_cyclonedds
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tactiled.errors import OperatorError
from tactiled.limited_log import RateLimitedLog
from tactiled.ros2 import names
from tactiled.ros2.cdr import decode, encode
from tactiled.ros2.definitions import (
    STANDARD,
    RosField,
    RosType,
    discovery_types,
    parse_types,
    rihs01,
    service_types,
)
from tactiled.ros2.own_types import own_definitions

logger = logging.getLogger(__name__)

# Best effort; reliable; reliable, and the newest message for late subscribers; the same while that message is
# younger than `_REPEATED_NS`.
Delivery = Literal["sensor", "event", "latched", "repeated"]
_DEPTH = {"sensor": 5, "event": 100, "latched": 1, "repeated": 1}  # sensor: that of ROS's sensor data profile
_REPEATED_NS = 3_000_000_000  # life of what is repeated each second: a late subscriber receives no older one
_REQUEST_HEAD = (RosField("client", "uint64"), RosField("number", "int64"))  # of rmw_cyclonedds
# Many hosts have no multicast on loopback: peers are looked for at the ports of the first 20 participants.
_LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>19"
    '</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
_OTHER_RMW = "its client needs RMW_IMPLEMENTATION=rmw_cyclonedds_cpp (docs/ros2.md)"
# DDS_LC_FATAL and DDS_LC_ERROR: of each packet that is not as it should be, whoever sent it, Cyclone DDS
# writes a warning with its bytes to stderr.
_LOGGED = 0x1 | 0x2
_INFO_TOPIC = "ros_discovery_info"
_INFO_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"


@dataclass(frozen=True)
class ServiceRequest:
    """Request that waits for `Node.reply`."""

    service: str
    values: Mapping[str, Any]
    client: int
    number: int


class TopicWriter:
    """Writer of one topic; `make` puts a map into a message of Cyclone DDS."""

    def __init__(self, writer: Any, make: Callable[[Mapping[str, Any]], Any], delivery: Delivery) -> None:
        self._writer, self._make = writer, make
        self._is_kept = delivery in ("latched", "repeated")
        self.refused = 0
        """Number of messages that DDS did not take, because a subscriber stopped reading."""

    @property
    def is_wanted(self) -> bool:
        """True where someone receives what is written now, or may receive it later."""
        return self._is_kept or bool(self._writer.matched_sub)

    def write(self, values: Mapping[str, Any]) -> None:
        """Publish a message, without waiting for anybody."""
        message = self._make(values)
        try:
            self._writer.write(message)
        except DDSException:
            self.refused += 1


class Node:
    """One node of ROS 2, which joins its domain at once and leaves it with `close`.

    The namespace has no leading slash. `gid_bytes` is 24 for ROS 2 Humble and older, 16 for Iron and newer.
    With `loopback` the node talks to this host alone, over its loopback interface.

    Raises
    ------
    OperatorError
        The domain cannot be joined.
    """

    def __init__(
        self, domain_id: int, name: str, namespace: str, *, gid_bytes: int = 16, loopback: bool = False
    ) -> None:
        self.name, self.domain_id = name, domain_id
        self._namespace, self._gid_bytes = namespace, gid_bytes
        self._types = parse_types({**STANDARD, **discovery_types(gid_bytes), **own_definitions()})
        # Requests and replies on the wire have 16 bytes in front, of which their type hashes know nothing.
        self._wire_types = self._types | {
            name: RosType(name, (*_REQUEST_HEAD, *kind.fields))
            for name, kind in self._types.items()
            if name.endswith(("_Request", "_Response"))
        }
        self._structs: dict[str, Any] = {}
        self._services: dict[str, tuple[Any, str, TopicWriter]] = {}
        self._unanswered = RateLimitedLog(logger, "service request not answered")
        self._readers: list[Any] = []
        self._writers: list[Any] = []
        try:
            self._domain = Domain(domain_id, _LOOPBACK) if loopback else None
            self._participant = DomainParticipant(domain_id, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise OperatorError(f"DDS domain {domain_id} cannot be joined: {error}") from None
        load_cyclonedds().dds_set_log_mask(_LOGGED)
        self._info = self._writer(_INFO_TOPIC, _INFO_TYPE, "latched", self._type_hash(_INFO_TYPE))
        self._announce()

    def writer(self, topic: str, kind: str, delivery: Delivery) -> TopicWriter:
        """Create a writer of a ROS topic with leading slash, by the full name of its type."""
        made = self._writer(f"rt{topic}", kind, delivery, self._type_hash(kind))
        self._announce()
        return made

    def serve(self, service: str, kind: str) -> None:
        """Create a service; `kind` is the full name of its type, such as ``std_srvs/srv/Trigger``."""
        mark = ".".join(f"{byte:02x}" for byte in secrets.token_bytes(24))
        hash_ = rihs01(kind, self._types | service_types(kind))
        own = f"serviceid={mark};typehash={hash_};".encode()
        topic = Topic(self._participant, f"rq{service}Request", _any_bytes(f"{kind}_Request"))
        reader = DataReader(self._participant, topic, _policies("event", own))
        self._readers.append(reader)
        writer = self._writer(f"rr{service}Reply", f"{kind}_Response", "event", own)
        self._services[service] = reader, f"{kind}_Request", writer
        self._announce()

    def requests(self) -> list[ServiceRequest]:
        """Return the requests that have arrived; those that cannot be answered are logged."""
        found = []
        now_s = time.monotonic()
        self._unanswered.write_counts(now_s)
        for name, (reader, kind, _) in self._services.items():
            for sample in reader.take(16):
                if not (data := getattr(sample, "data", b"")):  # a client that leaves
                    continue
                try:
                    values = decode(kind, self._wire_types, data)
                except ValueError:  # its id is not in the message, so that no reply would find it
                    words = f"{name}: {len(data)} bytes without the head of rmw_cyclonedds; {_OTHER_RMW}"
                    self._unanswered.add(words, now_s, kind=name)
                    continue
                found.append(ServiceRequest(name, values, values["client"], values["number"]))
        return found

    def reply(self, request: ServiceRequest, *, success: bool, message: str) -> None:
        """Answer a request."""
        head = {"client": request.client, "number": request.number}
        _, _, replies = self._services[request.service]
        replies.write(head | {"success": success, "message": message})

    def close(self) -> None:
        """Leave the domain: entities go with their participant."""
        self._participant._delete(self._participant._ref)  # noqa: SLF001  otherwise left to garbage collection
        if self._domain is not None:
            self._domain._delete(self._domain._ref)  # noqa: SLF001

    def _writer(self, topic: str, kind: str, delivery: Delivery, own: bytes) -> TopicWriter:
        struct = self._struct(kind)
        writer = DataWriter(
            self._participant, Topic(self._participant, topic, struct), _policies(delivery, own)
        )
        self._writers.append(writer)
        encoded = partial(encode, kind, self._wire_types)
        return TopicWriter(writer, lambda values: struct(encoded(values)), delivery)

    def _type_hash(self, kind: str) -> bytes:
        return f"typehash={rihs01(kind, self._types)};".encode()

    def _struct(self, name: str) -> Any:
        """Class of Cyclone DDS for a type: its description, around data that are encoded already."""
        if name not in self._structs:
            fields = {field.name: self._idl_type(field) for field in self._wire_types[name].fields}
            self._structs[name] = _encoded(name, fields)
        return self._structs[name]

    def _idl_type(self, field: RosField) -> Any:
        if field.kind == "string":
            kind: Any = idl_types.bounded_str[field.bound] if field.bound else str
        elif field.kind in self._types:
            kind = self._struct(field.kind)
        elif field.kind == "bool":
            kind = bool
        else:
            kind = getattr(idl_types, {"char": "uint8", "byte": "uint8"}.get(field.kind, field.kind))
        if field.size is None:
            return kind
        return idl_types.array[kind, field.size] if field.size else idl_types.sequence[kind]

    def _announce(self) -> None:
        """Publish which endpoints belong to this node."""
        entities = {
            "node_namespace": f"/{self._namespace}",
            "node_name": self.name,
            "reader_gid_seq": [self._gid(reader) for reader in self._readers],
            "writer_gid_seq": [self._gid(writer) for writer in self._writers[1:]],  # without this one
        }
        self._info.write({"gid": self._gid(self._participant), "node_entities_info_seq": [entities]})

    def _gid(self, entity: Any) -> dict[str, bytes]:
        return {"data": entity.guid.bytes.ljust(self._gid_bytes, b"\0")}


def _policies(delivery: Delivery, own: bytes) -> Any:
    is_kept = delivery in ("latched", "repeated")
    return Qos(
        Policy.Reliability.BestEffort
        if delivery == "sensor"
        else Policy.Reliability.Reliable(max_blocking_time=0),  # the loop never waits for a subscriber
        Policy.Durability.TransientLocal if is_kept else Policy.Durability.Volatile,
        Policy.Lifespan(_REPEATED_NS if delivery == "repeated" else duration(infinite=True)),
        Policy.History.KeepLast(_DEPTH[delivery]),
        Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
        Policy.Userdata(own),
    )


def _any_bytes(name: str) -> Any:
    """Class of Cyclone DDS for a type by its name alone, so that messages of any content arrive.

    Cyclone DDS drops what does not fit a description, with a line on stderr each time.
    """
    return _encoded(name, {"structure_needs_at_least_one_member": idl_types.uint8})


def _encoded(name: str, fields: dict[str, Any]) -> Any:
    """Make a class of Cyclone DDS that holds data that are encoded already."""
    kind = make_idl_struct(name.rsplit("/", 1)[-1], names.dds_type(name).replace("::", "."), fields)
    kind.__init__ = _hold
    kind.serialize = _held
    kind.deserialize = classmethod(_holding)
    kind.deserialize_key = kind.deserialize  # of a writer that leaves
    return kind


def _hold(self: Any, data: bytes) -> None:
    self.data = data


def _held(self: Any, *_: object, **__: object) -> bytes:
    data: bytes = self.data
    return data


def _holding(kind: Any, data: bytes, /, *_: object, **__: object) -> Any:
    return kind(data)
