"""ZeroMQ's wire protocol as a server with the mechanism NULL: bytes in, values out, no I/O.

::

    greeting (64 bytes)  ->  READY command  ->  commands and parts of messages
         |                       |                       |
         +-----------------------+-----------------------+--> Refused: nothing is read any more

ZMTP 3.1 (rfc.zeromq.org/spec/37) and 3.0 (rfc.zeromq.org/spec/23), as libzmq 4 speaks them. In 3.1 a
subscription is a command; in 3.0 it is a message whose first byte is 1 (subscribe) or 0 (cancel). A peer may
use either. The sizes of everything that is kept are bounded, and any bytes give values, never an exception.
"""

from dataclasses import dataclass

from tactiled.outside import shown

LONGEST_BYTES = 1024  # of a frame: a subscription is some 30 bytes, a READY of libzmq some 50
GREETING_BYTES = 64
LONGEST_PING = 16  # bytes of context that a PING may carry, rfc.zeromq.org/spec/37
_MORE, _LONG, _COMMAND = 1, 2, 4
_MECHANISM = slice(12, 32)

GREETING = b"\xff" + bytes(7) + b"\x01\x7f" + b"\x03\x01" + b"NULL".ljust(20, b"\0") + bytes(32)
"""Our greeting: signature, version 3.1, mechanism, as-server (zero with NULL), filler."""


@dataclass(frozen=True, slots=True)
class Greeted:
    """The greeting of the peer is complete and good: send READY."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The peer is ready; it says what it is, for example ``SUB``."""

    socket_type: str


@dataclass(frozen=True, slots=True)
class Subscribe:
    """The peer wants all topics that begin with `prefix`, in addition to what it wants already."""

    prefix: bytes


@dataclass(frozen=True, slots=True)
class Cancel:
    """The peer takes back one subscription to `prefix`."""

    prefix: bytes


@dataclass(frozen=True, slots=True)
class Ping:
    """The peer wants a PONG with this context."""

    context: bytes


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a message; with `more`, the next part belongs to the same message."""

    body: bytes
    more: bool


@dataclass(frozen=True, slots=True)
class Refused:
    """The connection must be closed; nothing that follows is read."""

    reason: str


Value = Greeted | Ready | Subscribe | Cancel | Ping | Part | Refused


class ZmtpDecoder:
    """Decode what one peer sends; one that announces a longer frame is refused before any of it is kept."""

    def __init__(self, longest_bytes: int = LONGEST_BYTES) -> None:
        self._longest_bytes = longest_bytes
        self._buffer = bytearray()  # of a frame whose rest is missing: fewer than `longest_bytes` + 9 bytes
        self._greeted = False
        self._ready = False
        self._refused = False

    def receive(self, data: bytes) -> list[Value]:
        """Take bytes as they come; the same values follow however the bytes are split."""
        values: list[Value] = []
        if self._refused:
            return values
        self._buffer += data
        taken = 0
        while not self._refused:
            value, size = self._next(taken)
            if value is not None:
                values.append(value)
                self._refused = isinstance(value, Refused)
            if not size:
                break
            taken += size
        del self._buffer[:taken]
        if self._refused:
            self._buffer.clear()
        return values

    def _next(self, begin: int) -> tuple[Value | None, int]:
        """Return the next value, if there is one, and the number of bytes used; 0: more are needed."""
        if not self._greeted:
            fault = _greeting_fault(self._buffer)
            if fault:
                return Refused(fault), 0
            self._greeted = len(self._buffer) >= GREETING_BYTES
            return (Greeted(), GREETING_BYTES) if self._greeted else (None, 0)
        buffer, available = self._buffer, len(self._buffer) - begin
        if available == 0:
            return None, 0
        flags = buffer[begin]
        if flags & ~(_MORE | _LONG | _COMMAND) or (flags & _COMMAND and flags & _MORE):
            return Refused(f"a frame with the flags {flags:#04x}, which no version has"), 0
        head = 9 if flags & _LONG else 2
        if available < head:
            return None, 0
        size = int.from_bytes(buffer[begin + 1 : begin + head])
        if size > self._longest_bytes:
            return Refused(f"a frame of {size} bytes; {self._longest_bytes} are allowed"), 0
        if available < head + size:
            return None, 0
        body = bytes(buffer[begin + head : begin + head + size])
        if flags & _COMMAND:
            return self._command(body), head + size
        if not self._ready:
            return Refused("a message before READY"), 0
        return Part(body, bool(flags & _MORE)), head + size

    def _command(self, body: bytes) -> Value | None:
        """Return the value of a command; None for one that asks for nothing."""
        n = body[0] if body else 0
        if not 0 < n < len(body):
            return Refused("a command without a name")
        name, data = body[1 : 1 + n], body[1 + n :]
        if name == b"ERROR":
            return Refused(f"it gave up: {shown(data[1:].decode(errors='replace'))}")
        if name == b"READY":
            if self._ready:
                return Refused("a second READY")
            self._ready = True
            return _ready_of(data)
        if not self._ready:
            return Refused("no READY after the greeting")
        if name == b"SUBSCRIBE":
            return Subscribe(data)
        if name == b"CANCEL":
            return Cancel(data)
        if name == b"PING":  # two bytes of time to live, which the kernel's keepalive does for us
            return Ping(data[2 : 2 + LONGEST_PING])
        return None  # PONG, and what a later version may add


def subscription(part: Part) -> Subscribe | Cancel | None:
    """Return the subscription that a message of ZMTP 3.0 is, or None for any other message."""
    if part.body[:1] == b"\1":
        return Subscribe(part.body[1:])
    return Cancel(part.body[1:]) if part.body[:1] == b"\0" else None


def message(*parts: bytes) -> bytes:
    """Encode a message of one or more parts."""
    return b"".join(
        _frame(part, _MORE if part_no < len(parts) else 0) for part_no, part in enumerate(parts, 1)
    )


def ready(socket_type: str) -> bytes:
    """Encode the READY command."""
    value = socket_type.encode()
    return _encoded_command(b"READY", b"\x0bSocket-Type" + len(value).to_bytes(4) + value)


def error(reason: str) -> bytes:
    """Encode the ERROR command, after which the connection is closed."""
    words = reason.encode("ascii", "replace")[:255]
    return _encoded_command(b"ERROR", bytes([len(words)]) + words)


def pong(context: bytes) -> bytes:
    """Encode the answer to a PING."""
    return _encoded_command(b"PONG", context)


def _frame(body: bytes, flags: int) -> bytes:
    if len(body) < 256:
        return bytes((flags, len(body))) + body
    return bytes((flags | _LONG,)) + len(body).to_bytes(8) + body


def _encoded_command(name: bytes, data: bytes) -> bytes:
    return _frame(bytes([len(name)]) + name + data, _COMMAND)


def _greeting_fault(head: bytes | bytearray) -> str:
    """Return the first fault of the bytes of a greeting that are there; empty for none."""
    if head[:1] not in (b"", b"\xff") or (len(head) > 9 and not head[9] & 1):
        return "no greeting of ZeroMQ"
    if len(head) > 10 and head[10] < 3:
        return "an old version of ZeroMQ; libzmq 4 or newer is needed"
    mechanism = bytes(head[_MECHANISM])
    name = mechanism.rstrip(b"\0").decode(errors="replace")
    if len(mechanism) == 20 and name != "NULL":
        return f"the mechanism {shown(name)}: connect without keys"
    return ""


def _ready_of(data: bytes) -> Ready | Refused:
    """Read the type of the socket from the properties of a READY command."""
    socket_type = b""
    while data:
        name_end = 1 + data[0]
        size = int.from_bytes(data[name_end : name_end + 4])
        end = name_end + 4 + size
        if end > len(data):
            return Refused("a READY whose properties are cut off")
        if data[1:name_end].lower() == b"socket-type":
            socket_type = data[name_end + 4 : end]
        data = data[end:]
    return Ready(socket_type.decode(errors="replace"))
