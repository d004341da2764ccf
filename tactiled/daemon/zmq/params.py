"""Configuration of the endpoints: which there are, and who may use them."""

from typing import Self

from pydantic import Field, model_validator

from tactiled.daemon.zmq.endpoints import RUNTIME, fault_of, is_wide
from tactiled.events.endpoints import DEFAULT_ENDPOINT, control_endpoint
from tactiled.tomlfile import Params


class PublishParams(Params):
    """Endpoints for events and requests, and access to them.

    They hold for the process: the files of several boards in one process must agree on all of them.
    """

    endpoints: tuple[str, ...] = Field(
        default=(DEFAULT_ENDPOINT, f"ipc://{RUNTIME}/events.ipc"),
        description="ZeroMQ endpoints to bind for events; an empty list publishes nothing. Requests are "
        "taken beside each: at the next TCP port, or at the ipc file with 'control' for 'events' in its "
        "name. {runtime} is /run/tactiled/NAME under systemd, else $XDG_RUNTIME_DIR/tactiled, or "
        "/tmp/tactiled-UID where this variable is not set.",
    )
    keys: str | None = Field(
        default=None,
        min_length=1,
        description="Folder of CURVE keys (`tactiled keys make`). Endpoints that other hosts can reach are "
        "encrypted and admit only clients of this folder.",
    )
    history_mb: float = Field(
        default=4.0,
        ge=0.01,
        le=1000,
        description="Memory for each topic, for subscribers that were away (10^6 bytes); 4 holds some 60 s "
        "of scans.",
    )
    allow_commands_over_tcp: bool = Field(
        default=False,
        description="Accept commands over loopback TCP too, where any user of this host may connect; "
        "otherwise over ipc, and from clients with keys.",
    )

    @model_validator(mode="after")
    def _reachable_only_with_keys(self) -> Self:
        for endpoint in self.endpoints:
            if fault := fault_of(endpoint):
                raise ValueError(f"publish.endpoints: {fault}")
        for endpoint in self.control:
            if fault := fault_of(endpoint):
                raise ValueError(f"publish.endpoints: for requests, the port after it: {fault}")
        endpoints = (*self.endpoints, *self.control)
        for endpoint in endpoints:
            if endpoints.count(endpoint) > 1:
                raise ValueError(
                    f"{endpoint!r} is named twice; each endpoint serves events or requests, once"
                )
            if is_wide(endpoint) and self.keys is None:
                raise ValueError(
                    f"{endpoint} can be reached from other hosts, unencrypted; use 127.0.0.1, or give a "
                    "folder of keys (tactiled keys make)"
                )
        return self

    @property
    def control(self) -> tuple[str, ...]:
        """Endpoints that take requests: one beside each of `endpoints`, where clients look for it."""
        return tuple(map(control_endpoint, self.endpoints))

    def is_guarded(self, endpoint: str) -> bool:
        """Return True for an endpoint that only clients with keys may use."""
        return is_wide(endpoint)
