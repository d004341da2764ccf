"""Pictures that users see: a log with its events, grooves under the array."""

from pathlib import Path
from typing import TYPE_CHECKING

from tactiled.errors import ConfigError, DataError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = (".png", ".pdf", ".svg")
"""Endings of the files that can be drawn."""


def check_picture(path: Path) -> None:
    """Refuse a picture that cannot be written: unknown ending, or no such folder."""
    if not (path.parent.is_dir() and path.suffix in PICTURES):
        raise ConfigError("--plot", [f"{path}: name a {', '.join(PICTURES)} in a folder that exists"])


def save(figure: "Figure", path: Path) -> None:
    """Write a picture; `DataError` where that fails, as on a full disk."""
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise DataError(f"{path}: the picture cannot be written: {error.strerror}") from None
