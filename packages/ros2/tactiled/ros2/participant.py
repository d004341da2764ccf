"""Topics, services and discovery of one ROS 2 node over Cyclone DDS.

ROS 2 on DDS: a topic is ``rt/`` and its name; a node is an entry of ``ros_discovery_info`` with the ids of
its endpoints; a service is two topics, and each message of rmw_cyclonedds begins with 16 bytes that say which
request it belongs to. rmw_fastrtps writes those ids into RTPS instead, to which Cyclone DDS for Python gives
no access: services answer clients that run rmw_cyclonedds_cpp, topics reach every DDS.
"""

import logging
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass
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
from tactiled.ros2.cdr import CdrEncoder, decode
from tactiled.ros2.definitions import RosField, RosType, parse_types, service_types
from tactiled.ros2.own_types import own_definitions
from tactiled.ros2.standard_types import STANDARD, discovery_types
from tactiled.ros2.typehash import rihs01

logger = logging.getLogger(__name__)

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
    """Writer of one topic."""

    def __init__(self, writer: Any, kind: Any, encoder: CdrEncoder, delivery: Delivery) -> None:
        self._writer, self._kind, self._encoder = writer, kind, encoder
        self._latched = delivery in ("latched", "repeated")
        self.refused = 0
        """Number of messages that DDS did not take, because a subscriber stopped reading."""

    @property
    def is_wanted(self) -> bool:
        """True where someone receives what is written now, or may receive it later."""
        return self._latched or bool(self._writer.matched_sub)

    def write(self, values: Mapping[str, Any]) -> None:
        """Publish a message, without waiting for anybody."""
        data = self._encoder.encode(values)
        try:
            self._writer.write(self._kind(data))
        except DDSException:
            self.refused += 1


@dataclass(frozen=True)
class _Service:
    requests: Any
    replies: TopicWriter


class Node:
    """One node of ROS 2, which joins its domain at once and leaves it with `close`.

    Parameters
    ----------
    name, namespace : str
        Name of the node, and its namespace without the leading slash.
    gid_bytes : int
        24 for ROS 2 Humble and older, 16 for Iron and newer.
    loopback : bool
        Talk to this host alone, over its loopback interface.

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
        self.types = parse_types({**STANDARD, **discovery_types(gid_bytes), **own_definitions()})
        self._kinds: dict[str, Any] = {}
        self._structs: dict[str, Any] = {}
        self._services: dict[str, _Service] = {}
        self._hashes: dict[str, str] = {}
        self._unanswered = RateLimitedLog(logger, "service request not answered")
        self._readers: list[Any] = []
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
        """Create a writer of a ROS topic.

        Parameters
        ----------
        topic : str
            Absolute name, with leading slash.
        kind : str
            Full name of the type.
        delivery : {"sensor", "event", "latched", "repeated"}
            Best effort; reliable; reliable, and the newest message for late subscribers; the same while that
            message is younger than 3 s.
        """
        made = self._writer(names.dds_topic(topic), kind, delivery)
        self._announce()
        return made

    def serve(self, service: str, kind: str) -> None:
        """Create a service; `kind` is the full name of its type, such as ``std_srvs/srv/Trigger``."""
        mark = ".".join(f"{byte:02x}" for byte in secrets.token_bytes(24))
        own = f"serviceid={mark};typehash={self._service_hash(kind)};".encode()
        request, reply = self._with_head(f"{kind}_Request"), self._with_head(f"{kind}_Response")
        qos = self._policies("event", own)
        topic = Topic(self._participant, names.dds_request(service), _any_bytes(request))
        reader = DataReader(self._participant, topic, qos)
        self._readers.append(reader)
        writer = self._writer(names.dds_reply(service), reply, "event", own, hashed=False)
        self._services[service] = _Service((reader, request), writer)
        self._announce()

    def requests(self) -> list[ServiceRequest]:
        """Return the requests that have arrived; those that cannot be answered are logged."""
        found = []
        now_s = time.monotonic()
        self._unanswered.write_counts(now_s)
        for name, service in self._services.items():
            reader, kind = service.requests
            for sample in reader.take(16):
                if not (data := getattr(sample, "data", b"")):  # a client that leaves
                    continue
                try:
                    values = decode(kind, self.types, data)
                except ValueError:  # its id is not in the message, so that no reply would find it
                    words = f"{name}: {len(data)} bytes without the head of rmw_cyclonedds; {_OTHER_RMW}"
                    self._unanswered.add(words, now_s, kind=name)
                    continue
                found.append(ServiceRequest(name, values, values["client"], values["number"]))
        return found

    def reply(self, request: ServiceRequest, *, success: bool, message: str) -> None:
        """Answer a request."""
        head = {"client": request.client, "number": request.number}
        self._services[request.service].replies.write(head | {"success": success, "message": message})

    def close(self) -> None:
        """Leave the domain: entities go with their participant."""
        self._participant._delete(self._participant._ref)  # noqa: SLF001  otherwise left to garbage collection
        if self._domain is not None:
            self._domain._delete(self._domain._ref)  # noqa: SLF001

    def _writer(
        self, topic: str, kind: str, delivery: Delivery, own: bytes = b"", *, hashed: bool = True
    ) -> TopicWriter:
        if hashed:
            own += f"typehash={rihs01(kind, self.types)};".encode()
        writer = DataWriter(self._participant, self._topic_of(topic, kind), self._policies(delivery, own))
        if topic != _INFO_TOPIC:
            self._writers.append(writer)
        return TopicWriter(writer, self._kind(kind), CdrEncoder(kind, self.types), delivery)

    def _policies(self, delivery: Delivery, own: bytes) -> Any:
        return Qos(
            Policy.Reliability.BestEffort
            if delivery == "sensor"
            else Policy.Reliability.Reliable(max_blocking_time=0),  # the loop never waits for a subscriber
            Policy.Durability.TransientLocal
            if delivery in ("latched", "repeated")
            else Policy.Durability.Volatile,
            Policy.Lifespan(_REPEATED_NS if delivery == "repeated" else duration(infinite=True)),
            Policy.History.KeepLast(_DEPTH[delivery]),
            Policy.DataRepresentation(use_cdrv0_representation=True, use_xcdrv2_representation=False),
            Policy.Userdata(own),
        )

    def _topic_of(self, topic: str, kind: str) -> Any:
        return Topic(self._participant, topic, self._kind(kind))

    def _service_hash(self, kind: str) -> str:
        if kind not in self._hashes:  # once: `_with_head` changes the types that it is made of
            self._hashes[kind] = rihs01(kind, self.types | service_types(kind))
        return self._hashes[kind]

    def _with_head(self, name: str) -> str:
        """Put the 16 bytes before the fields of a request or reply; return the name of its type."""
        kind = self.types[name]
        if kind.fields[:2] != _REQUEST_HEAD:
            self.types[name] = RosType(name, (*_REQUEST_HEAD, *kind.fields))
        return name

    def _kind(self, name: str) -> Any:
        """Class of Cyclone DDS for a type: its description, around data that are encoded already."""
        if name not in self._kinds:
            self._kinds[name] = _encoded(self._struct(name))
        return self._kinds[name]

    def _struct(self, name: str) -> Any:
        if name not in self._structs:
            fields = {field.name: self._idl_type(field) for field in self.types[name].fields}
            bare = name.rsplit("/", 1)[-1]
            self._structs[name] = make_idl_struct(bare, names.dds_type(name).replace("::", "."), fields)
        return self._structs[name]

    def _idl_type(self, field: RosField) -> Any:
        if field.kind == "string":
            kind: Any = idl_types.bounded_str[field.bound] if field.bound else str
        elif field.kind in self.types:
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
            "writer_gid_seq": [self._gid(writer) for writer in self._writers],
        }
        self._info.write({"gid": self._gid(self._participant), "node_entities_info_seq": [entities]})

    def _gid(self, entity: Any) -> dict[str, bytes]:
        return {"data": entity.guid.bytes.ljust(self._gid_bytes, b"\0")}


def _any_bytes(name: str) -> Any:
    """Class of Cyclone DDS for a type by its name alone, so that messages of any content arrive.

    Cyclone DDS drops what does not fit a description, with a line on stderr each time.
    """
    fields = {"structure_needs_at_least_one_member": idl_types.uint8}
    bare = name.rsplit("/", 1)[-1]
    return _encoded(make_idl_struct(bare, names.dds_type(name).replace("::", "."), fields))


def _encoded(kind: Any) -> Any:
    """Make a class of Cyclone DDS hold data that are encoded already."""
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
