"""Everything tactiled raises on purpose, split by who can act on it.

::

    TactiledError
    |-- OperatorError          the person at the keyboard can mend it
    |   |-- ConfigError        a file or option says something impossible; every fault at once
    |   |-- DataError          a data file cannot be read as what it claims to be
    |   |-- PortError          the port cannot be opened or was lost (retried by the daemon)
    |   `-- UnavailableError   something of this host is in use or not there yet: worth trying again
    `-- ContractError          our own code broke a promise: a bug, please report it

Corrupt bytes, missing frames and estimates that cannot be made are *values* (``Corrupt``, ``Gap``,
``TextureEvent.status``), not exceptions: they are what a robot sees every day. So is a
board that is not the one configured, or that refuses a command: `status` says so.
"""

from collections.abc import Sequence


class TactiledError(Exception):
    """Root of the tree; ``exit_code`` is what the command line ends with."""

    exit_code = 1


class OperatorError(TactiledError):
    """The person at the keyboard can mend it."""

    exit_code = 2


class ConfigError(OperatorError):
    """A file or option says something impossible.

    Parameters
    ----------
    source : str
        The file (or "command line") that is wrong.
    faults : sequence of str
        One line for each fault, each naming its place and, where we can, what to do.
    """

    def __init__(self, source: str, faults: Sequence[str]) -> None:
        self.source = source
        self.faults = tuple(faults)
        lines = "".join(f"\n  {fault}" for fault in self.faults)
        super().__init__(f"{source}:{lines}" if len(self.faults) > 1 else f"{source}: {self.faults[0]}")


class DataError(OperatorError):
    """A data file cannot be read as what it claims to be."""


class PortError(OperatorError):
    """The port cannot be opened, or was lost; the daemon retries, one-shot commands end."""


class UnavailableError(OperatorError):
    """Something of this host is in use or not there yet; a service manager should try again."""

    exit_code = 1


class ContractError(TactiledError):
    """Our own code broke a promise between two rooms: a bug."""
