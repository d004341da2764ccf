"""Pages that are generated: fields of the messages, verbs, options, metrics, C++, and all figures."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import NoneType
from typing import Any, Literal, get_args, get_origin

import click
from annotated_types import Ge, Gt, Le, Lt
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from tactiled import resources
from tactiled.cli.entry import cli
from tactiled.cli.packages import DeferredCommand
from tactiled.config import Config
from tactiled.daemon.operations.metrics import METRICS
from tactiled.tomlfile import Params
from tactiled.zenoh.fleet import FLEET_METRICS
from tools.figures import load_figures
from tools.site.cpp_reference import cpp_page

_HEAD = ("v", "seq", "board", "run")  # fields that mean the same in every message
_TYPES = {str: "text", int: "integer", float: "number", bool: "true or false"}


def generated_pages() -> dict[str, str]:
    """Return the pages by their places on the site."""
    return {
        "reference/fields.md": fields_page(),
        "reference/verbs.md": verbs_page(),
        "reference/options.md": options_page(),
        "reference/metrics.md": metrics_page(),
        "reference/cpp.md": cpp_page(),
        "docs/figures/index.md": figures_page(),
    }


def figures_page() -> str:
    """Return what the benches have written: each figure with its date, and whether its code has changed."""
    head = "# All figures\n\nEach heading links to the figure's file, which has commit, machine and seeds."
    parts = (f"## [{name}]({name}.json)\n\n{one.block([])}" for name, one in load_figures().items())
    return "\n\n".join([head, *parts])


def fields_page() -> str:
    """Return the fields of each message with type and meaning, from the JSON Schemas."""
    lines = [
        "# Fields",
        "",
        "Fields of the messages, by topic. Every message also has `v`, `seq`, `board` and `run`."
        " [Events](../protocols/events.md) says when a message is sent and when it may be used.",
    ]
    for path in sorted(resources.shipped("protocols", "events").glob("*.schema.json")):
        schema = json.loads(path.read_text("utf-8"))
        lines += ["", f"## {schema['title']}", "", schema["description"], ""]
        lines += _table(["field", "type", "meaning"], list(_fields(schema["properties"])))
    return "\n".join([*lines, ""])


def _fields(properties: Mapping[str, Any], prefix: str = "") -> Iterator[list[str]]:
    """Yield a row for each field, and for those of the maps in it."""
    for name, field in properties.items():
        if name in _HEAD:
            continue
        item = field.get("items", {})
        kind = f"list of {item['type']}s" if item else field["type"]
        if "enum" in field:
            kind = ", ".join(f"`{choice}`" if choice else "empty" for choice in field["enum"])
        yield [f"`{prefix}{name}`", kind, field.get("description", "")]
        yield from _fields(field.get("properties") or item.get("properties", {}), f"{prefix}{name}.")


def verbs_page() -> str:
    """Return the help of each verb, those of the distributions beside `tactiled` included."""
    lines = ["# Verbs", "", "What `tactiled VERB --help` prints."]
    for context in _verbs(cli.make_context("tactiled", [], resilient_parsing=True)):
        lines += ["", f"## {context.command_path}", "", "```text", context.get_help(), "```"]
    return "\n".join([*lines, ""])


def options_page() -> str:
    """Return the keys of ``tactiled.toml`` with type, range, default and meaning."""
    lines = [
        "# Options",
        "",
        "Every key of a configuration, by table. A key without a default may be omitted."
        " [tactiled.toml](../config/tactiled.toml) is a file to copy, with advice.",
    ]
    for table in config_tables():
        rows = [
            [f"`{key}`", _values(field), _toml(table.defaults[key]), field.description or ""]
            for key, field in table.schema.model_fields.items()
            if key in table.defaults
        ]
        if rows:
            summary = (table.schema.__doc__ or "").split("\n")[0]
            lines += ["", f"## [{table.name}]", "", summary, ""]
            lines += _table(["key", "value", "default", "meaning"], rows)
    return "\n".join([*lines, ""])


def metrics_page() -> str:
    """Return the metrics of a daemon and of the list of a fleet, with kind, labels and meaning."""
    daemon = [
        [f"`tactiled_{name}`", metric.kind, _codes(metric.labels), metric.meaning]
        for name, metric in METRICS.items()
    ]
    fleet = [
        [f"`tactiled_{name}`", "gauge", _codes(metric.labels), metric.meaning]
        for name, metric in FLEET_METRICS.items()
    ]
    head = ["metric", "kind", "further labels", "meaning"]
    return "\n".join(
        [
            "# Metrics",
            "",
            "What the page of `metrics.port` has for Prometheus ([service](../docs/service.md)). Each metric"
            " but `tactiled_info` has the label `board`, the serial number of the board.",
            "",
            *_table(head, daemon),
            "",
            "## Fleet",
            "",
            "What the page of `tactiled fleet --serve` has ([fleet](../docs/fleet.md#list-of-all-boards))."
            " Each metric has the labels `host` and `board`; a value that is not known is left out.",
            "",
            *_table(head, fleet),
            "",
        ]
    )


def _codes(words: Sequence[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _verbs(context: click.Context) -> Iterator[click.Context]:
    """Yield a context for each verb of a group, and for those of its groups."""
    group = context.command
    assert isinstance(group, click.Group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, DeferredCommand):
            command = command.load()
        assert command is not None, name
        inner = click.Context(command, context, name, terminal_width=100)
        yield inner
        if isinstance(command, click.Group):
            yield from _verbs(inner)


@dataclass(frozen=True)
class ConfigTable:
    """Table of ``tactiled.toml``."""

    name: str  # such as ``detect.grip``
    schema: type[Params]
    defaults: Mapping[str, object]  # of its keys; `PydanticUndefined` for one that is required


def config_tables(
    schema: type[Params] = Config, name: str = "", default: object = None
) -> Iterator[ConfigTable]:
    """Yield the tables of the configuration, each before the tables in it.

    Parameters
    ----------
    default : object
        Default of the whole table, where it has one; its values replace the defaults of the keys.
    """
    given = {key: getattr(default, key, field.default) for key, field in schema.model_fields.items()}
    inner = {
        key: field.annotation
        for key, field in schema.model_fields.items()
        if isinstance(field.annotation, type) and issubclass(field.annotation, Params)
    }
    yield ConfigTable(name, schema, {key: value for key, value in given.items() if key not in inner})
    for key, table in inner.items():
        yield from config_tables(table, f"{name}.{key}".lstrip("."), given[key])


def _values(field: FieldInfo) -> str:
    """Type and range of a key."""
    signs = {Gt: ("gt", ">"), Ge: ("ge", ">="), Lt: ("lt", "<"), Le: ("le", "<=")}
    bounds = [
        f"{sign} {getattr(bound, name)}"
        for kind, (name, sign) in signs.items()
        for bound in field.metadata
        if isinstance(bound, kind)
    ]
    return ", ".join([_type(field.annotation), *bounds])


def _type(annotation: Any) -> str:
    if get_origin(annotation) is Literal:
        return ", ".join(f'`"{choice}"`' for choice in get_args(annotation))
    inner = [one for one in get_args(annotation) if one not in (NoneType, ...)]
    if get_origin(annotation) is tuple:
        return f"list of {_type(inner[0])}s"
    return _type(inner[0]) if inner else _TYPES[annotation]


def _toml(default: object) -> str:
    """Return a default as a file has it."""
    if default is PydanticUndefined:
        return "required"
    if default is None:
        return ""
    value = list(default) if isinstance(default, tuple) else default
    return f"`{json.dumps(value)}`"  # strings, numbers, true and false and lists are the same in TOML


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]
