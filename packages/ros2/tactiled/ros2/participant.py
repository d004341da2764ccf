"""Topics and discovery of one ROS 2 node over Cyclone DDS.

ROS 2 on DDS: a topic is ``rt/`` and its name; a node is an entry of ``ros_discovery_info`` with the ids of
its endpoints.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Literal

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl_types
from cyclonedds.internal import load_cyclonedds
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tactiled.errors import OperatorError
from tactiled.ros2 import names
from tactiled.ros2.cdr import encode
from tactiled.ros2.definitions import STANDARD, RosField, discovery_types, parse_types, rihs01
from tactiled.ros2.own_types import own_definitions

# Best effort; reliable; reliable, and the newest message for late subscribers; the same while that message is
# younger than `_REPEATED_NS`.
Delivery = Literal["sensor", "event", "latched", "repeated"]
_DEPTH = {"sensor": 5, "event": 100, "latched": 1, "repeated": 1}  # sensor: that of ROS's sensor data profile
_REPEATED_NS = 3_000_000_000  # life of what is repeated each second: a late subscriber receives no older one
# Many hosts have no multicast on loopback: peers are looked for at the ports of the first 20 participants.
_LOOPBACK = (
    '<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
    "</General><Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>19"
    '</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
# DDS_LC_FATAL and DDS_LC_ERROR: of each packet that is not as it should be, whoever sent it, Cyclone DDS
# writes a warning with its bytes to stderr.
_LOGGED = 0x1 | 0x2
_INFO_TOPIC = "ros_discovery_info"
_INFO_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"


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
        self._structs: dict[str, Any] = {}
        self._writers: list[Any] = []
        try:
            self._domain = Domain(domain_id, _LOOPBACK) if loopback else None
            self._participant = DomainParticipant(domain_id, Qos(Policy.Userdata(b"enclave=/;")))
        except DDSException as error:
            raise OperatorError(f"DDS domain {domain_id} cannot be joined: {error}") from None
        load_cyclonedds().dds_set_log_mask(_LOGGED)
        self._info = self._writer(_INFO_TOPIC, _INFO_TYPE, "latched")
        self._announce()

    def writer(self, topic: str, kind: str, delivery: Delivery) -> TopicWriter:
        """Create a writer of a ROS topic with leading slash, by the full name of its type."""
        made = self._writer(f"rt{topic}", kind, delivery)
        self._announce()
        return made

    def close(self) -> None:
        """Leave the domain: entities go with their participant."""
        self._participant._delete(self._participant._ref)  # noqa: SLF001  otherwise left to garbage collection
        if self._domain is not None:
            self._domain._delete(self._domain._ref)  # noqa: SLF001

    def _writer(self, topic: str, kind: str, delivery: Delivery) -> TopicWriter:
        struct, own = self._struct(kind), f"typehash={rihs01(kind, self._types)};".encode()
        writer = DataWriter(
            self._participant, Topic(self._participant, topic, struct), _policies(delivery, own)
        )
        self._writers.append(writer)
        encoded = partial(encode, kind, self._types)
        return TopicWriter(writer, lambda values: struct(encoded(values)), delivery)

    def _struct(self, name: str) -> Any:
        """Class of Cyclone DDS for a type: its description, around data that are encoded already."""
        if name not in self._structs:
            fields = {field.name: self._idl_type(field) for field in self._types[name].fields}
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
            "reader_gid_seq": [],
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
