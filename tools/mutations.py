"""The small faults that `tools.mutate` makes in a Python file."""

import ast
import builtins
from collections.abc import Iterator
from dataclasses import dataclass

# Operator: what may stand in its place.
_SWAPS: dict[type[ast.AST], tuple[type[ast.AST], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.Mult,),
    ast.Pow: (ast.Mult,),
    ast.MatMult: (ast.Mult,),
    ast.LShift: (ast.RShift,),
    ast.RShift: (ast.LShift,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
    ast.BitXor: (ast.BitAnd,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
}
_LOG_METHODS = {"debug", "info", "warning", "error", "exception", "critical"}
# What is not behaviour: types for the checker, and switches of a class that only a type checker or repr sees.
_SKIPPED_FIELDS = {"annotation", "returns", "decorator_list"}
_SKIPPED_NAMES = {"__all__", "__slots__"}


@dataclass(frozen=True)
class Mutation:
    """One change of one file: the characters `start` to `end` become `new`."""

    file: str
    start: int
    end: int
    line: int
    old: str
    new: str

    def apply(self, source: str) -> str:
        """Source text with this change."""
        return source[: self.start] + self.new + source[self.end :]

    def __str__(self) -> str:
        old, new = (" ".join(text.split()) for text in (self.old, self.new))
        return f"{self.file}:{self.line}: {old} -> {new}"


def mutations(source: str, file: str) -> list[list[Mutation]]:
    """Places of a file that can be changed, each with one or two alternatives, in the order of the file."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    encoded = [line.encode() for line in source.splitlines(keepends=True)]

    def offset(line: int, column: int) -> int:
        return starts[line - 1] + len(encoded[line - 1][:column].decode())  # columns of ast count bytes

    found = []
    for node, texts in _changes(ast.parse(source)):
        start = offset(node.lineno, node.col_offset)
        end = offset(node.end_lineno or node.lineno, node.end_col_offset or 0)
        places = [Mutation(file, start, end, node.lineno, source[start:end], text) for text in texts]
        found.append([one for one in places if _compiles(one.apply(source))])
    return [place for place in found if place]


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutated", "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return False
    return True


def _changes(node: ast.AST) -> Iterator[tuple[ast.expr | ast.stmt, list[str]]]:
    """Nodes under a node, and the texts that may replace them."""
    if _is_skipped(node):
        return
    if isinstance(node, ast.expr | ast.stmt) and (texts := list(_alternatives(node))):
        yield node, texts
    for name, value in ast.iter_fields(node):
        if name in _SKIPPED_FIELDS or (isinstance(node, ast.ClassDef) and name == "keywords"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST):
                continue
            if name in ("test", "ifs") and not isinstance(node, ast.Assert) and isinstance(child, ast.expr):
                yield child, [f"not ({ast.unparse(child)})"]
            yield from _changes(child)


def _is_skipped(node: ast.AST) -> bool:
    """Say whether nothing under a node is behaviour: texts, logs, types, names that a module exports."""
    match node:
        case ast.JoinedStr():
            return True
        case ast.Expr(value=ast.Constant()):  # a docstring
            return True
        case ast.Call(func=ast.Attribute(attr=method)) if method in _LOG_METHODS:
            return True
        case ast.Expr(value=ast.Call(func=ast.Attribute(attr=method))) if method in _LOG_METHODS:
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Assign(targets=[ast.Name(id=name)]) if name in _SKIPPED_NAMES:
            return True
        case ast.BinOp(left=left, right=right):
            return any(_is_text_or_type(side) for side in (left, right))
    return False


def _is_text_or_type(node: ast.AST) -> bool:
    match node:
        case ast.JoinedStr() | ast.Constant(value=str() | None):
            return True
        case ast.Name(id=name):
            return isinstance(getattr(builtins, name, None), type) or (
                name[0].isupper() and not name.isupper()
            )
    return False


def _alternatives(node: ast.expr | ast.stmt) -> Iterator[str]:
    match node:
        case ast.Compare(left=left, ops=ops, comparators=others):
            for place, op in enumerate(ops):
                for swap in _SWAPS[type(op)]:
                    swapped = [*ops[:place], swap(), *ops[place + 1 :]]
                    yield _text(ast.Compare(left, swapped, others))  # type: ignore[arg-type]
        case ast.BinOp(left=left, op=op, right=right):
            for swap in _SWAPS[type(op)]:
                yield _text(ast.BinOp(left, swap(), right))  # type: ignore[arg-type]
        case ast.BoolOp(op=op, values=values):
            for swap in _SWAPS[type(op)]:
                yield _text(ast.BoolOp(swap(), values))  # type: ignore[arg-type]
        case ast.AugAssign(target=target, op=op, value=value):
            for swap in _SWAPS[type(op)]:
                yield ast.unparse(ast.AugAssign(target, swap(), value))  # type: ignore[arg-type]
            yield "pass"
        case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert(), operand=operand):
            yield _text(operand)
        case ast.Constant(value=bool() as value):
            yield str(not value)
        case ast.Constant(value=int() | float() as value):
            yield from (f"({value + 1})", f"({value - 1})")
        case ast.Return(value=ast.expr() as value) if not (
            isinstance(value, ast.Constant) and value.value is None
        ):
            yield "return None"
        case ast.Expr() | ast.Raise() | ast.Break() | ast.Continue() | ast.Delete():
            yield "pass"
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
            yield "pass"


def _text(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"
