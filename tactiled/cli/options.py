"""What several verbs share: the same option is written, and explained, once."""

from pathlib import Path

import click

CONFIG_ENV = "TACTILED_CONFIG"
FILE = click.Path(path_type=Path, dir_okay=False)
SPEED = click.FloatRange(0, 1000)  # mm/s, as in the configuration; never negative: directions are found

CONFIG = click.option("-c", "--config", type=FILE, envvar=CONFIG_ENV, help="tactiled.toml of this board.")
PORT = click.option("-p", "--port", help="Serial port or pyserial URL; takes the place of port.url.")
KEYS = click.option("--keys", type=FILE, help="Our file of `tactiled keys make`.")


def need_board(config: Path | None, port: str | None, to: str = "run") -> None:
    """Refuse a call that names no board."""
    if config is None and port is None:
        raise click.UsageError(f"say --config FILE, or --port PORT to {to} with defaults")
