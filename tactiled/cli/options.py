"""Options and checks shared by several commands.

The checks find usage errors before the command imports numpy, which takes most of a second.
"""

import importlib.util
import sys
from pathlib import Path
from typing import Any

import click

from tactiled import tomltext
from tactiled.errors import DataError, OperatorError, install_command
from tactiled.outside import need_regular

CONFIG_ENV = "TACTILED_CONFIG"
FILE = click.Path(path_type=Path, dir_okay=False)
FILES = click.Path(path_type=Path)  # a directory too, which stands for the files in it


class Names(click.ParamType[tuple[str, ...]]):
    """Names with commas between, of those that are `known` where these are given; an empty text has none."""

    name = "NAMES"

    def __init__(self, what: str = "", known: tuple[str, ...] = ()) -> None:
        self._what, self._known = what, known

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the names; fail on an unknown one."""
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in value.split(",")) if value else ()
        for name in names:
            if self._known and name not in self._known:
                self.fail(f"no {self._what} {name!r}; there are: {', '.join(self._known)}", param, ctx)
        return names


SPEED = click.FloatRange(0, 1000)  # mm/s, as in the configuration; never negative: directions are found

CONFIG = click.option("-c", "--config", type=FILE, envvar=CONFIG_ENV, help="tactiled.toml of this board.")
CONFIGS = click.option(
    "-c",
    "--config",
    "configs",
    type=FILES,
    multiple=True,
    envvar=CONFIG_ENV,
    help="Configuration of a board, or a directory with one for each board; may be repeated.",
)
PORT = click.option("-p", "--port", help="Serial port or pyserial URL; overrides port.url.")
COLUMNS = click.option(
    "--columns",
    type=Names(),
    default=(),
    metavar="NAMES",
    help="Columns of a table in channel order: names with commas between, or 'tax*'.",
)
TIME_UNIT = click.option(
    "--time-unit", type=click.Choice(["s", "ms", "us", "ns"]), help="Unit of the times in a table."
)
TOPIC = click.option("--topic", help="Topic of a bag, or TOPIC.FIELD, whose numbers are the channels.")
BOARD = click.option(
    "--board", default="", help="Serial number of the board, where the daemon reads several."
)
KEYS = click.option(
    "--keys",
    type=FILE,
    help="Key file of this client: of `tactiled keys make`, or for zenoh of `tactiled keys fleet`.",
)


def _or_no_terminal(_context: click.Context, _parameter: click.Parameter, is_asked: bool) -> bool:
    return is_asked or not sys.stdout.isatty()


JSON = click.option(
    "--json",
    "as_json",
    is_flag=True,
    callback=_or_no_terminal,
    help="Print JSON lines in a terminal, too; they are always printed into a pipe or a file.",
)


def need_board(config: Path | None, port: str | None, to: str = "run") -> None:
    """Refuse a call that names no board."""
    if config is None and port is None:
        raise click.UsageError(f"give --config FILE, or --port PORT to {to} with defaults")


def need_toml(*paths: Path | None) -> None:
    """Refuse a file that cannot be read or is not TOML."""
    for path in paths:
        if path is not None:
            tomltext.read(path)


def need_readable(*paths: Path) -> None:
    """Refuse a data file that cannot be read."""
    for path in paths:
        try:
            need_regular(path)
            path.open("rb").close()
        except OSError as error:
            raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def need_extra(module: str, extra: str, what: str, distribution: str = "tactiled") -> None:
    """Refuse a command whose optional library is not installed, and name the command that installs it.

    Parameters
    ----------
    module : str
        Name under which the library is imported.
    extra : str
        Extra of the distribution that installs it; empty where it is no extra of that.
    """
    if importlib.util.find_spec(module) is None:
        raise OperatorError(f"{what} needs {module}: {install_command(extra, distribution)}")


def need_named(name_or_path: str | None, kind: str) -> None:
    """Refuse an array (kind ``config/arrays``) or a layout (``protocols``) that is missing or not TOML."""
    if name_or_path is not None:
        tomltext.read(tomltext.locate(name_or_path, kind))
