"""Verbs of the distributions beside this one, found by their entry points.

A distribution offers a verb in the entry-point group `tactiled.commands` as ``VERB = "MODULE:COMMAND"``;
COMMAND is a `click.Command`, and the entry point ``keys.fleet`` is the verb `fleet` of the group `keys`.
MODULE is imported when the verb is called. `VERBS` has the verbs of this repository: ``--help`` lists them
without an import, and one that is not installed says what to install.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import click

from tactiled.errors import OperatorError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "tactiled.commands"


@dataclass(frozen=True)
class PackagedVerb:
    """Verb of a distribution of this repository."""

    package: str  # folder in ``packages/``, and extra of `tactiled`; the distribution is ``tactiled-PACKAGE``
    summary: str  # first line of its help


VERBS = {
    "calibrate": PackagedVerb(
        "calibration", "Fit newtons to the readings of LOG with the record of a force sensor."
    ),
    "demo": PackagedVerb(
        "emulator",
        "Run board emulator, daemon and subscriber for half a minute; print a table and write two pictures.",
    ),
    "emulate": PackagedVerb(
        "emulator",
        "Emulate a board: play a scene on a pty or TCP port, and print its ground truth to stdout.",
    ),
    "fleet": PackagedVerb(
        "zenoh", "List the boards of a zenoh network: state, age, utilisation, loss, firmware, disk."
    ),
    "keys.fleet": PackagedVerb(
        "zenoh",
        "Make the certificates of a zenoh network: FOLDER/NAME.json5 for each member, for its host.",
    ),
    "tune": PackagedVerb(
        "calibration",
        "Count what each setting reports in your own hold and motion; propose a setting and the friction.",
    ),
    "web": PackagedVerb("web", "Show boards live in a browser: freshness, array, slips, grooves, timeline."),
    "zenoh": PackagedVerb(
        "zenoh", "Forward a daemon's messages to a zenoh network, and requests from there to the daemon."
    ),
}
"""Verbs by the names of their entry points."""

PARTS = {"detect.files": "archive"}
"""Entry points of functions that verbs of the core call, with their packages."""


@cache
def _installed() -> Mapping[str, "EntryPoint"]:
    """Return the entry points of installed verbs by name."""
    from importlib.metadata import entry_points  # takes 20 ms, and most commands need none

    return {found.name: found for found in entry_points(group=GROUP)}


def _package_of(entry: str) -> str:
    return PARTS[entry] if entry in PARTS else VERBS[entry].package


def find(entry: str, what: str) -> "EntryPoint":
    """Return an entry point of this repository, not imported yet.

    An `OperatorError` says what to install if its distribution is missing.

    Parameters
    ----------
    what : str
        Feature that needs it.
    """
    found = _installed().get(entry)
    if found is None:
        words = f"{what} needs tactiled-{_package_of(entry)}, which is not installed"
        raise OperatorError(f"{words}: {install_words(entry)}")
    return found


def install_words(entry: str) -> str:
    """Return the command that installs what an entry point of this repository needs."""
    package = _package_of(entry)
    return f"pip install 'tactiled[{package}]', or ./packages/{package} in a checkout"


class DeferredCommand(click.Command):
    """Stand-in for a verb of another distribution, whose module is imported when the verb is called."""

    def __init__(self, name: str, entry: str) -> None:
        super().__init__(name, help=VERBS[entry].summary if entry in VERBS else None)
        self.entry = entry

    def load(self) -> click.Command:
        """Import the verb; raises as `find`."""
        command: click.Command = find(self.entry, f"`{self.name}`").load()
        return command

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Return the context of the verb itself, which click then invokes."""
        return self.load().make_context(info_name, args, parent, **extra)

    def get_short_help_str(self, limit: int = 45) -> str:
        """Return the summary, or what to install."""
        found = _installed().get(self.entry)
        if found is None:
            return f"Not installed: tactiled-{_package_of(self.entry)}."
        if self.help is None:
            return f"Verb of {found.dist.name if found.dist else found.module}."
        return super().get_short_help_str(limit)


class OpenGroup(click.Group):
    """Group whose further verbs are those of other distributions.

    Parameters
    ----------
    prefix : str
        Of the names of their entry points.
    """

    def __init__(self, *args: Any, prefix: str = "", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._prefix = prefix

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return all verbs: those here, those of this repository, and those that others have installed."""
        further = {
            entry.removeprefix(self._prefix)
            for entry in (*VERBS, *_installed())
            if entry.startswith(self._prefix)
        }
        return sorted({*super().list_commands(ctx), *(verb for verb in further if "." not in verb)})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a verb; one of another distribution is not imported yet."""
        own = super().get_command(ctx, cmd_name)
        entry = f"{self._prefix}{cmd_name}"
        if own is not None or "." in cmd_name or not (entry in VERBS or entry in _installed()):
            return own
        return DeferredCommand(cmd_name, entry)
