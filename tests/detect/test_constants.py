"""Each number of the detectors says where it comes from, and tuned ones say on what."""

import ast
import io
import re
import tokenize
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import pytest

import tactiled.detect.suite

ROOM = Path(tactiled.detect.suite.__file__).parent
ORIGINS = ("derived", "physical", "prior", "choice", "tuned")
_ORIGIN = re.compile(rf"# ({'|'.join(ORIGINS)})\b")
_WORLDS = re.compile(r"bench|recording|seeds|uSkin|eFlesh|Printed|worlds|Coverage")


class Constant(NamedTuple):
    """Numbers that a module names, and the comments before and beside them."""

    module: str
    names: tuple[str, ...]
    comment: str


def constants(path: Path) -> list[Constant]:
    """Return what a module assigns in upper case, if numbers are in it."""
    source = path.read_text(encoding="utf-8")
    comments = {
        token.start[0]: token.string
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    lines = source.splitlines()
    found = []
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        names = tuple(name.id for target in _targets(node) for name in _names(target))
        if not names or not all(name.strip("_").isupper() for name in names) or not _has_numbers(node.value):
            continue
        beside = " ".join(comments.get(row, "") for row in range(node.lineno, (node.end_lineno or 0) + 1))
        row, before = node.lineno - 1, ""
        while row and lines[row - 1].startswith("#"):
            row -= 1
            before = f"{comments[row + 1]} {before}"
        found.append(Constant(path.relative_to(ROOM).as_posix(), names, f"{beside} {before}".strip()))
    return found


def _targets(node: ast.Assign | ast.AnnAssign) -> list[ast.expr]:
    return node.targets if isinstance(node, ast.Assign) else [node.target]


def _names(target: ast.expr) -> list[ast.Name]:
    return [name for name in ast.walk(target) if isinstance(name, ast.Name)]


def _has_numbers(value: ast.expr) -> bool:
    """Numbers, tuples of numbers and their products; not words, nor tables of classes."""
    leaves = [node for node in ast.walk(value) if isinstance(node, ast.Constant)]
    is_made = any(isinstance(node, ast.Call | ast.Dict | ast.JoinedStr) for node in ast.walk(value))
    numbers = [leaf for leaf in leaves if isinstance(leaf.value, int | float)]
    return bool(numbers) and len(numbers) == len(leaves) and not is_made


def _fault(comment: str) -> str:
    origin = _ORIGIN.search(comment)
    if origin is None:
        return f"say derived, physical, prior, choice or tuned, and why: {comment!r}"
    if origin[1] not in ("derived", "choice") and not comment[origin.end() :].strip(": "):
        return "why?"
    if origin[1] == "tuned" and not _WORLDS.search(comment):
        return "on which worlds or recordings?"
    return ""


MODULES = sorted(ROOM.rglob("*.py"))
ALL = [constant for path in MODULES for constant in constants(path)]


def test_constants_are_found() -> None:
    names = {name for constant in ALL for name in constant.names}
    assert {"CONTACT_SDS", "GROWS", "_CLOSING_S", "INCIPIENT_USED"} <= names


def test_each_constant_says_where_it_comes_from() -> None:
    faults = [f"{one.module}: {one.names[0]}: {fault}" for one in ALL if (fault := _fault(one.comment))]
    assert not faults, "\n".join(faults)


@pytest.mark.parametrize(
    ("comment", "fault"),
    [
        ("# of the load", "say derived, physical, prior, choice or tuned"),
        ("# prior", "why?"),
        ("# tuned: the best of three", "on which worlds or recordings?"),
        ("# tuned: the best of three on the worlds of `bench grip`", ""),
        ("# derived", ""),
    ],
)
def test_a_constant_without_an_origin_is_refused(comment: str, fault: str) -> None:
    assert _fault(comment).startswith(fault)
    assert bool(_fault(comment)) == bool(fault)


def test_what_is_tuned_stays_few() -> None:
    """Each new one is a piece of the worlds that it was set on; take one out before one comes in."""
    origins: Counter[str] = Counter()
    for constant in ALL:
        origin = _ORIGIN.search(constant.comment)
        origins[origin[1] if origin else ""] += len(constant.names)
    assert origins["tuned"] <= 20
