"""Docstrings of the Python reference: the fields of a class, described beside them, become a section."""

import re

import griffe

from tools.site.field_comments import comment_of, description_of


class ReferenceDocstrings(griffe.Extension):  # type: ignore[misc]  # the level docs of the environment has it
    """Complete the docstrings that mkdocstrings shows."""

    def on_instance(self, *, obj: griffe.Object, **_: object) -> None:
        """Remove the mark of a literal block, which Markdown does not have."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r" ::$", "", obj.docstring.value, flags=re.MULTILINE)

    def on_class_members(self, *, cls: griffe.Class, **_: object) -> None:
        """Move the fields into a section of the docstring of their class, unless it has that."""
        fields = [
            field
            for field in cls.attributes.values()
            if field.annotation is not None and not field.is_private and "property" not in field.labels
        ]
        if fields and cls.docstring is not None and "Attributes\n---" not in cls.docstring.value:
            rows = [f"{field.name} : {field.annotation}\n    {_meaning(field)}" for field in fields]
            cls.docstring.value += "\n\nAttributes\n----------\n" + "\n".join(rows)
        for field in fields:
            field.docstring = None


def _meaning(field: griffe.Attribute) -> str:
    if field.docstring is not None:
        return " ".join(field.docstring.value.split())
    lines = field.lines_collection[field.filepath]
    described = description_of(str(field.value))
    return described or comment_of(lines[: field.lineno - 1], lines[field.endlineno - 1])
