"""Rules for requests: which Host and Origin are accepted, and who may give commands. No I/O.

A page of another site must neither read a board nor command it. Three checks prevent that:

- `Host` must be an IP address, ``localhost``, the name of this host, or one that the operator allowed. A site
  that lets its own name resolve to a loopback address (DNS rebinding) sends its own name.
- `Origin`, where the browser sends it, must be the page itself.
- A command needs the token in a header, which no form and no request of another origin without CORS can set.
"""

import contextlib
import hmac
import ipaddress
import socket
from collections.abc import Iterable
from urllib.parse import urlsplit


class Guard:
    """Checks of requests to one server, which may be called by further host names.

    `token` is what a command must carry; empty where commands are not allowed at all.
    """

    def __init__(self, token: str = "", host_names: Iterable[str] = ()) -> None:
        self._token = token
        own = socket.gethostname().lower()
        self._names = {"localhost", own, f"{own}.local", *(name.lower() for name in host_names)}

    @property
    def allows_commands(self) -> bool:
        """True where commands with the token are accepted."""
        return bool(self._token)

    def refuse_host(self, host: str) -> str:
        """Return why a `Host` header is refused; empty where it is accepted."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            name = ""
        if name.lower() in self._names or _address_of(name) is not None:
            return ""
        return f"this server is not {name!r}: start it with --host-name {name} if it is"

    def refuse_origin(self, origin: str | None, host: str) -> str:
        """Return why an `Origin` header is refused; programs that are no browsers send none."""
        if origin is None:
            return ""
        with contextlib.suppress(ValueError):  # no URL at all
            parts = urlsplit(origin)
            if parts.scheme in ("http", "https") and parts.netloc == host:
                return ""
        return f"requests from pages of {origin!r} are refused"

    def refuse_command(self, authorization: str | None) -> str:
        """Return why a command is refused for its token; empty where it is accepted."""
        if not self._token:
            return "commands are not allowed: start tactiled web with --allow-commands"
        scheme, _, given = (authorization or "").partition(" ")
        given_bytes = given.encode(errors="surrogateescape")  # a header may have bytes that are no UTF-8
        if scheme != "Bearer" or not hmac.compare_digest(given_bytes, self._token.encode()):
            return "the token is missing or wrong: open the address that tactiled web printed"
        return ""


def _address_of(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(name)
    return None


def is_loopback(host: str) -> bool:
    """Return True for an address or name to which only this host can connect."""
    address = _address_of(host)
    return host == "localhost" if address is None else address.is_loopback
