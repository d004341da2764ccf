"""TOML files by shipped name or path, as plain dictionaries.

Needs the standard library only, so that the command line reports a wrong name before it imports numpy.
"""

import json
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tactiled import resources
from tactiled.errors import ConfigError, DataError
from tactiled.outside import read_text, shown

_CALLED = {"config/arrays": "array", "protocols": "layout", "config/calibration": "calibration"}

_DEPTH = 32  # of brackets and of dotted keys; the deepest of our files has four
_WORD_CHARACTERS = 400  # outside of strings; the largest number, 1.8e308, has 309 digits when written in full
# What has no end is taken up to the end of the line or text: the parser refuses it.
_STRING_OR_COMMENT = re.compile(
    r'"""(?:\\.|[^\\])*?(?:"{3,5}|\\?\Z)|\'\'\'.*?(?:\'{3,5}|\Z)'
    r'|"(?:\\[^\n]|[^"\\\n])*"?|\'[^\'\n]*\'?|#[^\n]*',
    re.DOTALL,
)
_LONG_WORD = re.compile(rf"[\w+.-]{{{_WORD_CHARACTERS + 1},}}")
_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{_DEPTH},}}[\w-]")
_BRACKET = re.compile(r"[][{}]")
_HEADER = re.compile(r"[ \t]*\[+[ \t]*([\w.-]+)[ \t]*\]")
_KEY = re.compile(r"[ \t]*([\w.-]+)[ \t]*=")


def locate(name_or_path: str, kind: str) -> Path:
    """Return the path of an array (``config/arrays``) or layout (``protocols``) by shipped name or path.

    `ConfigError` if no shipped file has this name; a path is not checked here: `read` does that.
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
    """Read a TOML file into plain dictionaries; `ConfigError` if that is not possible."""
    try:
        text = read_text(path)
        if fault := _excess(text):
            raise ConfigError(str(path), [fault])
        document = tomllib.loads(text)
    except FileNotFoundError:
        near = sorted(p.stem for p in path.parent.glob("*.toml")) if path.parent.is_dir() else []
        hint = f"; beside it there are: {', '.join(near)}" if near else ""
        raise ConfigError(str(path), [f"no such file{hint}"]) from None
    except DataError as error:
        raise ConfigError(str(path), [str(error).removeprefix(f"{path}: ")]) from None
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), [f"not valid TOML: {error}"]) from None
    if name := _with_nul(document):
        raise ConfigError(str(path), [f"{name}: has the character NUL, which no name or path may have"])
    return document


def _excess(text: str) -> str:
    """Return what a TOML text has too much of for its parser, with its place; empty where nothing is.

    `tomllib` calls itself for each bracket, takes quadratic time for dotted keys, and raises no error of its
    own for a long number.
    """
    bare = _STRING_OR_COMMENT.sub(
        lambda found: "s" * (found[0][0] != "#") + "\n" * found[0].count("\n"), text
    )
    if word := _LONG_WORD.search(bare):
        n = len(word[0])
        return f"{_place(bare, word.start())}: a word or number of {n} characters; at most {_WORD_CHARACTERS}"
    if key := _LONG_KEY.search(bare):
        return f"{_place(bare, key.start())}: a key of more than {_DEPTH} parts"
    depth = 0
    for bracket in _BRACKET.finditer(bare):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > _DEPTH:
            return f"{_place(bare, bracket.start())}: more than {_DEPTH} brackets in one another"
    return ""


def _with_nul(value: object, name: str = "") -> str:
    """Return the name of the first string or key with NUL, at which system calls fail; empty without one."""
    if isinstance(value, str):
        return (name or "text") if "\0" in value else ""
    items: Iterable[tuple[object, object]] = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    for key, one in items:
        part = f"{name}.{key}" if name else str(key)
        if found := _with_nul(str(key), shown(part).strip("'")) or _with_nul(one, part):
            return found
    return ""


def _place(bare: str, position: int) -> str:
    """Name the table, the key and the line of a place in a TOML text without strings and comments."""
    before = bare[: position + 1]
    table = key = ""
    for line in before.splitlines():
        if found := _HEADER.match(line):
            table, key = f"{found[1]}.", ""
        elif found := _KEY.match(line):
            key = found[1]
    name = shown((table + key).rstrip(".")).strip("'")
    return f"{name or 'text'} (line {before.count(chr(10)) + 1})"
