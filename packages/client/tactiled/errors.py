"""Exceptions of tactiled, divided by the person who can correct the cause.

::

    TactiledError
    |-- OperatorError          the user can correct it
    |   |-- ConfigError        a file or option has an invalid value; lists every fault
    |   |-- DataError          a data file is not of the expected format
    |   |-- PortError          the port cannot be opened or was lost (the daemon tries again)
    |   `-- UnavailableError   a resource of this host is in use or not there yet: worth trying again
    `-- ContractError          code of tactiled violated an interface: a bug, please report it

Corrupt bytes, missing frames and estimates that cannot be made are *values* (``Corrupt``, ``Gap``,
``TextureEvent.status``), not exceptions, because they occur in normal operation. The same holds for a
board that is not the configured one or refuses a command: `status` reports it.
"""

import re
import shlex
from collections.abc import Sequence


class TactiledError(Exception):
    """Base of all exceptions of tactiled; ``exit_code`` is the exit code of the command line."""

    exit_code = 1


class OperatorError(TactiledError):
    """Fault that the user can correct."""

    exit_code = 2


class ConfigError(OperatorError):
    """Invalid value in a file or option (`source`); each fault is a line with its place and what to do."""

    def __init__(self, source: str, faults: Sequence[str]) -> None:
        self.source = source
        self.faults = tuple(faults)
        lines = "".join(f"\n  {fault}" for fault in self.faults)
        super().__init__(f"{source}:{lines}" if len(self.faults) > 1 else f"{source}: {self.faults[0]}")


class DataError(OperatorError):
    """Data file that is not of the expected format."""


class PortError(OperatorError):
    """Port that cannot be opened, or was lost; the daemon tries again, other commands end."""


class UnavailableError(OperatorError):
    """Resource of this host that is in use or not there yet; a service manager should try again."""

    exit_code = 1


class ContractError(TactiledError):
    """Violation of an interface between two parts of tactiled: a bug."""


def install_command(extra: str, distribution: str = "tactiled") -> str:
    """Return the command that installs what an extra needs, from wherever the user stands.

    No package index has to have tactiled for it: the libraries themselves are named, as the metadata of the
    installed distribution have them. An empty `extra` stands for what the distribution always needs.
    """
    from importlib import metadata  # takes 20 ms, and every start of a command would pay it

    try:
        needed = metadata.requires(distribution) or []
    except metadata.PackageNotFoundError:
        needed = []
    pattern = re.compile(rf"\s*extra == ['\"]{re.escape(extra)}['\"]\s*" if extra else "")
    parts = [line.partition(";") for line in needed]
    found = [name.strip() for name, _, marker in parts if pattern.fullmatch(marker)]
    libraries = [name for name in found if not name.startswith("tactiled")]
    if not found:
        return f"pip install '.[{extra}]' in the checkout of {distribution}"
    return f"pip install {shlex.join(libraries or found)}"
