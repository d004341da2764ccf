"""Topics of one ROS 2 node over zenoh, as rmw_zenoh has them; the counterpart of `participant.Node` for DDS.

A topic has the key ``DOMAIN/NAME/TYPE/HASH``, CDR as payload, and an attachment with sequence number, time
and id of the publisher. Nodes and publishers are liveliness tokens below ``@ros2_lv``. After rmw_zenoh's
design.md; checked against `zenoh-ros2-sdk`, an independent implementation, and never against ROS itself.
"""

import secrets
import struct
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import zenoh

from tactiled.ros2 import names
from tactiled.ros2.cdr import encode
from tactiled.ros2.definitions import STANDARD, parse_types, rihs01
from tactiled.ros2.own_types import own_definitions
from tactiled.ros2.participant import Delivery

_ENCLAVE = "%"
_NODE_ID = 0
# reliability : durability : history kind and depth : deadline : lifespan : liveliness; empty: the default.
# A cache of zenoh has no lifespan: what is repeated each second is not kept, so that nobody receives it old.
_QOS = {
    "sensor": "2::,5:,:,:,,", "event": "::,100:,:,:,,", "latched": ":1:,1:,:,:,,", "repeated": "::,1:,:,:,,"
}  # fmt: skip
_GID_BYTES = 16


def add_timestamps(config: "zenoh.Config") -> None:
    """Let a session write timestamps, as rmw_zenoh does: the cache of latched topics needs them."""
    config.insert_json5("timestamping/enabled", "true")


class ZenohTopicWriter:
    """Writer of one topic; `make` encodes a map."""

    refused = 0

    def __init__(
        self,
        session: "zenoh.Session",
        key: str,
        make: Callable[[Mapping[str, Any]], bytes],
        delivery: Delivery,
    ) -> None:
        self._make = make
        self._gid = secrets.token_bytes(_GID_BYTES)
        self._seq = 0
        self._latched = delivery == "latched"
        options: dict[str, Any] = {
            "encoding": "application/cdr", "congestion_control": zenoh.CongestionControl.DROP, "express": True
        }  # fmt: skip
        self._publisher: Any
        if self._latched:  # rmw_zenoh asks the cache of a transient-local publisher with a query
            cache = zenoh.ext.CacheConfig(1)
            self._publisher = zenoh.ext.declare_advanced_publisher(
                session, key, cache=cache, publisher_detection=True, **options
            )
        else:
            self._publisher = session.declare_publisher(key, **options)

    @property
    def is_wanted(self) -> bool:
        """True where someone receives what is written now, or may receive it later."""
        return self._latched or bool(self._publisher.matching_status.matching)

    def write(self, values: Mapping[str, Any]) -> None:
        """Publish a message, without waiting for anybody."""
        self._seq += 1
        head = struct.pack("<qqB", self._seq, time.time_ns(), _GID_BYTES)
        self._publisher.put(self._make(values), attachment=head + self._gid)


class ZenohNode:
    """One node of ROS 2; its session has timestamps (`add_timestamps`), and is closed by its owner.

    It has no services: commands come over ``tactile/HOST/command``, where routers can tell who may give them.
    """

    def __init__(self, session: "zenoh.Session", domain_id: int, name: str, namespace: str) -> None:
        self.name, self.domain_id = name, domain_id
        self.types = parse_types({**STANDARD, **own_definitions()})
        self._session = session
        self._head = f"@ros2_lv/{domain_id}/{session.zid()}/{_NODE_ID}"
        self._node = f"{_ENCLAVE}/{_mangled(f'/{namespace}')}/{name}"
        self._tokens = [self._token(f"{self._head}/{_NODE_ID}/NN/{self._node}")]

    def writer(self, topic: str, kind: str, delivery: Delivery) -> ZenohTopicWriter:
        """Create a writer of a ROS topic; parameters as for `participant.Node.writer`."""
        on_wire = f"{names.dds_type(kind)}/{rihs01(kind, self.types)}"
        number = len(self._tokens)
        self._tokens.append(
            self._token(f"{self._head}/{number}/MP/{self._node}/{_mangled(topic)}/{on_wire}/{_QOS[delivery]}")
        )
        make = partial(encode, kind, self.types)
        return ZenohTopicWriter(self._session, f"{self.domain_id}{topic}/{on_wire}", make, delivery)

    def close(self) -> None:
        """Take back all tokens."""
        for token in self._tokens:
            token.undeclare()

    def _token(self, key: str) -> "zenoh.LivelinessToken":
        return self._session.liveliness().declare_token(key)


def _mangled(name: str) -> str:
    return name.replace("/", "%")
