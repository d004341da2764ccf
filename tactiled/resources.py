"""Paths of the files that ship with tactiled: protocols/, config/, systemd/."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
# An installed wheel carries the files inside the package; a checkout has them beside it.
_ROOT = _PACKAGE / "_data" if (_PACKAGE / "_data").is_dir() else _PACKAGE.parent


def shipped(*parts: str) -> Path:
    """Return the path of a shipped file or folder, e.g. ``shipped("config", "scenes")``."""
    return _ROOT.joinpath(*parts)


def find(name_or_path: str, kind: str) -> Path:
    """Return the path of a TOML file that is given by path, or by its name in a folder of shipped files.

    `kind` is that folder, such as ``config/arrays``. The file may not exist: the code that opens it reports
    that, with the name that the user gave.
    """
    if not is_name(name_or_path):
        return Path(name_or_path)
    return shipped(*kind.split("/")) / f"{name_or_path}.toml"


def is_name(name_or_path: str) -> bool:
    """Return True for a bare name, which `find` looks up among the shipped files."""
    return not Path(name_or_path).suffix and "/" not in name_or_path


def shipped_names(kind: str) -> list[str]:
    """Return the sorted names of the shipped files of a kind."""
    return sorted(path.stem for path in shipped(*kind.split("/")).glob("*.toml"))
