"""Meaning of a field of a data class or of a schema, which stands beside the field in the code."""

import ast
import re
from collections.abc import Sequence
from itertools import takewhile


def comment_of(above: Sequence[str], last: str) -> str:
    """Return the comment at the end of a field's last line, or else the one directly above the field."""
    if beside := re.search(r"  # (?!type:|noqa|fmt:)(.+)$", last):
        return beside[1]
    block = list(takewhile(re.compile(r" *# ").match, reversed(above)))
    return " ".join(line.strip().removeprefix("# ") for line in reversed(block))


def description_of(value: str) -> str:
    """Return the `description` of a call of pydantic's `Field`, empty for another value."""
    call = ast.parse(value, mode="eval").body
    words = [one.value for one in getattr(call, "keywords", ()) if one.arg == "description"]
    return str(ast.literal_eval(words[0])) if words else ""
