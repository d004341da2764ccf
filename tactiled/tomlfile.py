"""Check of TOML files against a schema, with a list of all faults, their places and hints.

Packages describe their parameters as `Params` (frozen, no unknown keys, no NaN). This module makes them from
a TOML document, and turns pydantic's errors into lines that a user can act on.
"""

import difflib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from tactiled.errors import ConfigError
from tactiled.outside import SHOWN_CHARACTERS, shown
from tactiled.tomltext import read

__all__ = ["Params", "load", "parse", "read"]

_FAULTS = 50  # that are listed; a file with more is of another kind
_BARE = re.compile(rf"[A-Za-z0-9_-]{{1,{SHOWN_CHARACTERS}}}")


class Params(BaseModel):
    """Base of all parameters: immutable, without unknown keys, finite."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        strict=False,
        defer_build=True,  # most commands need few of the tables, and building all is slow
    )


P = TypeVar("P", bound=BaseModel)


def load(path: Path, schema: type[P]) -> P:
    """Read a TOML file into `schema`; `ConfigError` if it is missing or no TOML, or with every fault."""
    return parse(read(path), schema, str(path))


def parse(document: Mapping[str, Any], schema: type[P], source: str) -> P:
    """Check plain dictionaries against `schema`; `ConfigError` lists every fault."""
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        details = error.errors(include_url=False)
        faults = list(dict.fromkeys(_explain(detail, schema) for detail in details[:_FAULTS]))
        if len(details) > _FAULTS:
            faults.append(f"and {len(details) - _FAULTS} more")
        raise ConfigError(source, faults) from None


def _explain(detail: ErrorDetails, schema: type[BaseModel]) -> str:
    place = _place(detail["loc"], schema)
    if detail["type"] == "extra_forbidden":
        return f"{place}: unknown key{_hint(detail['loc'], schema)}"
    if detail["type"] == "missing":
        return f"{place}: missing"
    if detail["type"] in ("union_tag_not_found", "union_tag_invalid"):
        key = _place((*detail["loc"], detail["ctx"]["discriminator"].strip("'")), schema)
        if detail["type"] == "union_tag_not_found":
            return f"{key}: missing"
        known = detail["ctx"]["expected_tags"].replace("'", "")
        return f"{key}: input should be one of {known} (got {shown(detail['ctx']['tag'])})"
    message = detail["msg"].removeprefix("Value error, ")
    message = message[0].lower() + message[1:]
    given = detail["input"]
    if isinstance(given, str):
        message += f" (got {shown(given)})"
    elif isinstance(given, int | float | bool):
        message += f" (got {given!r})"
    return f"{place}: {message}" if place else message


def _place(location: tuple[int | str, ...], schema: type[BaseModel]) -> str:
    """``("grids", 0, "x_mm")`` as ``grids[0].x_mm``."""
    place = ""
    models = [schema]
    for part in location:
        if isinstance(part, int):
            place += f"[{part}]"
            continue
        if not _tagged(part, models):  # the tag of a union is in the location, but no key
            place += f".{part if _BARE.fullmatch(part) else shown(part)}"
        models = _models_below(part, models)
    return place.lstrip(".")


def _hint(location: tuple[int | str, ...], schema: type[BaseModel]) -> str:
    """Nearest known key, as a hint for a wrong unit or a typing error."""
    key = str(location[-1])[:SHOWN_CHARACTERS]
    known = [name for model in _models_at(location[:-1], schema) for name in model.model_fields]
    stem = key.rsplit("_", 1)[0]
    units = [name for name in known if name.rsplit("_", 1)[0] == stem or name.startswith(f"{key}_")]
    if units:
        return f"; units belong to the name here: use {units[0]}"
    near = difflib.get_close_matches(key, known, 1)
    if near:
        return f"; did you mean {near[0]}?"
    return f"; known here: {', '.join(known)}" if known else ""


def _models_at(location: tuple[int | str, ...], schema: type[BaseModel]) -> list[type[BaseModel]]:
    """Models that are allowed at a place of the document."""
    models = [schema]
    for part in location:
        if isinstance(part, str):
            models = _models_below(part, models)
    return models


def _models_below(part: str, models: list[type[BaseModel]]) -> list[type[BaseModel]]:
    """Models below a part of a location: those with that tag, those of that key, or the same ones."""
    return (
        _tagged(part, models)
        or [
            inner
            for model in models
            if part in model.model_fields
            for inner in _models_in(model.model_fields[part].annotation)
        ]
        or models
    )


def _tagged(part: str, models: list[type[BaseModel]]) -> list[type[BaseModel]]:
    """Models of a union that have `part` as their tag; none where there is no choice."""
    if len(models) == 1:
        return []
    return [
        model
        for model in models
        if any(part in get_args(field.annotation) for field in model.model_fields.values())
    ]


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)
