"""Configuration of the endpoints: which there are, and who may use them."""

from typing import Self

from pydantic import Field, model_validator

from tactiled.daemon.zmq.endpoints import RUNTIME, fault_of, is_wide
from tactiled.events.endpoints import DEFAULT_ENDPOINT, control_endpoint
from tactiled.tomlfile import Params


class PublishParams(Params):
    """Endpoints for events and requests, and access to them."""

    endpoints: tuple[str, ...] = Field(
        default=(DEFAULT_ENDPOINT, f"ipc://{RUNTIME}/events.ipc"),
        description="ZeroMQ endpoints to bind; an empty list publishes nothing. PlotJuggler uses port 9872 "
        "by default; a second daemon on the host needs another port. {runtime} is /run/tactiled/NAME under "
        "systemd, else $XDG_RUNTIME_DIR/tactiled.",
    )
    control_endpoints: tuple[str, ...] | None = Field(
        default=None,
        description="Endpoints for requests and commands. If omitted, there is one beside each of "
        "`endpoints`: the next TCP port, or control.ipc in the same folder. Clients look there by default.",
    )
    keys: str | None = Field(
        default=None,
        min_length=1,
        description="Folder of CURVE keys (`tactiled keys make`). Endpoints that other hosts can reach are "
        "encrypted and admit only clients of this folder.",
    )
    allow_plaintext_on_network: bool = Field(
        default=False,
        description="Allow endpoints that other hosts can reach without keys. Anyone on that network can "
        "then read the events, forge them, and command the daemon: set it only on a private network.",
    )
    history_mb: float = Field(
        default=4.0,
        ge=0.01,
        le=1000,
        description="Memory for each topic, for subscribers that were away (10^6 bytes). 4 holds a minute of "
        "scans of 36 channels at 100 Hz, and hours of every other topic.",
    )
    allow_commands_over_tcp: bool = Field(
        default=False,
        description="Accept commands over loopback TCP too, where any user of this host may connect. If "
        "false, commands are accepted over ipc, from the daemon's user and group, and from clients with "
        "keys; loopback TCP answers requests for state and events only.",
    )

    @model_validator(mode="after")
    def _reachable_only_if_meant(self) -> Self:
        for name, endpoint in self._named:
            if fault := fault_of(endpoint):
                raise ValueError(f"{name}: {fault}")
        endpoints = [endpoint for _, endpoint in self._named]
        for endpoint in endpoints:
            if endpoints.count(endpoint) > 1:
                raise ValueError(
                    f"{endpoint!r} is named twice; each endpoint serves events or requests, once"
                )
            if is_wide(endpoint) and self.keys is None and not self.allow_plaintext_on_network:
                raise ValueError(
                    f"{endpoint} can be reached from other hosts, unencrypted; use 127.0.0.1, give a folder "
                    "of keys (tactiled keys make), or set allow_plaintext_on_network = true"
                )
        return self

    @property
    def _named(self) -> list[tuple[str, str]]:
        """Endpoints, each with the name of the option that it comes from."""
        events = [("publish.endpoints", endpoint) for endpoint in self.endpoints]
        name = "publish.control_endpoints"
        if self.control_endpoints is None:
            name += " (left out: the port after that of publish.endpoints)"
        return events + [(name, endpoint) for endpoint in self.control]

    @property
    def control(self) -> tuple[str, ...]:
        """Endpoints that take requests."""
        if self.control_endpoints is not None:
            return self.control_endpoints
        return tuple(control for endpoint in self.endpoints if (control := control_endpoint(endpoint)))

    def is_guarded(self, endpoint: str) -> bool:
        """Return True for an endpoint that only clients with keys may use."""
        return self.keys is not None and is_wide(endpoint)
