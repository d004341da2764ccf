"""TOML files by shipped name or path, as plain dictionaries.

Needs the standard library only, so that the command line reports a wrong name before it imports numpy.
"""

import json
import tomllib
from pathlib import Path
from typing import Any

from tactiled import resources
from tactiled.errors import ConfigError

_CALLED = {"config/arrays": "array", "protocols": "layout", "config/calibration": "calibration"}


def locate(name_or_path: str, kind: str) -> Path:
    """Return the path of an array (``config/arrays``) or layout (``protocols``) by shipped name or path.

    Raises
    ------
    ConfigError
        No shipped file has this name. A path is not checked here: `read` does that.
    """
    path = resources.find(name_or_path, kind)
    if resources.is_name(name_or_path) and not path.exists():
        what, known = _CALLED[kind], ", ".join(resources.shipped_names(kind))
        raise ConfigError(what, [f"no {what} named {name_or_path!r}; shipped: {known}; or give a file"])
    return path


def quoted(text: str) -> str:
    """Return a text as a string of TOML, which escapes as JSON does, and DEL too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def read(path: Path) -> dict[str, Any]:
    """Read a TOML file into plain dictionaries.

    Raises
    ------
    ConfigError
        The file is missing, cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        near = sorted(p.stem for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        hint = f"; beside it there are: {', '.join(near)}" if near else ""
        raise ConfigError(str(path), [f"no such file{hint}"]) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), [f"cannot be read: {error}"]) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), [f"not valid TOML: {error}"]) from None
