"""Events as rows of a table (Apache Arrow): one column for each field of any event."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, get_args, get_origin

import pyarrow

from tactiled.events.codec import message_key
from tactiled.events.types import EVENT_TYPES
from tactiled.offline import OFFLINE_TOPICS

# Value of `topic` in the row that stands for a whole file.
FILE_TOPIC = "file"
_PLAIN = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}
_FILE_COLUMNS = [
    pyarrow.field("file", pyarrow.string(), nullable=False),
    pyarrow.field("topic", pyarrow.string(), nullable=False),
    pyarrow.field("board", pyarrow.string()),
    pyarrow.field("error", pyarrow.string()),
    pyarrow.field("summary", pyarrow.string()),
    pyarrow.field("seq", pyarrow.int64()),
    pyarrow.field("timestamp", pyarrow.float64()),
]


def schema() -> pyarrow.Schema:
    """Make the columns: those of every row, then the fields of all detected events.

    A field that two kinds of event have is one column. A column is null in rows of events without the field.
    """
    columns = {column.name: column for column in _FILE_COLUMNS}
    for topic in OFFLINE_TOPICS:
        kind = EVENT_TYPES[topic]
        for field in dataclasses.fields(kind):
            key = message_key(field.name)
            columns.setdefault(key, pyarrow.field(key, _arrow_type(field.type)))
    return pyarrow.schema(list(columns.values()))


def _arrow_type(kind: Any) -> pyarrow.DataType:
    if dataclasses.is_dataclass(kind):
        return pyarrow.struct([(part.name, _arrow_type(part.type)) for part in dataclasses.fields(kind)])
    if get_origin(kind) is tuple:
        return pyarrow.list_(_arrow_type(get_args(kind)[0]))
    return _PLAIN.get(kind, pyarrow.string())  # else a Literal of strings


def file_row(file: str, summary: str, error: str = "") -> pyarrow.Table:
    """Make the row of a file itself, with lines for people, and why it could not be analysed (else empty)."""
    return _to_table([{"file": file, "topic": FILE_TOPIC, "error": error, "summary": summary}])


def event_rows(file: str, messages: Iterable[Mapping[str, Any]]) -> pyarrow.Table:
    """Make a row for each message with `topic`, as `detect` prints it."""
    return _to_table([{**message, "file": file} for message in messages])


def _to_table(rows: Iterable[Mapping[str, Any]]) -> pyarrow.Table:
    known = schema()
    return pyarrow.Table.from_pylist(
        [{name: _as_unicode(row.get(name)) for name in known.names} for row in rows], known
    )


def _as_unicode(value: Any) -> Any:
    """Write bytes of a file name that are not UTF-8 as escapes; leave all else as it is."""
    if not isinstance(value, str):
        return value
    return value.encode(errors="surrogateescape").decode(errors="backslashreplace")
