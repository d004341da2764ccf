"""Reference of the C++ client and of its C interface, from their headers.

libclang finds the declarations; the page has their text, without bodies and private members. Headers of other
libraries are not read, so that the page is the same on every host: libclang recovers from unknown types.
"""

import re
from collections.abc import Iterator
from itertools import takewhile

from clang.cindex import AccessSpecifier, Cursor, Index, TokenKind
from clang.cindex import CursorKind as Kind

from tactiled import resources

_HEAD = """# C++: the client

Public declarations and their comments, from the headers. [Native clients](../docs/native.md) says how to
install the headers, and has programs to begin with. `tactiled.hpp` includes the headers of this page, except
those of the controller and of the C interface. All C++ names are in the namespace `tactiled`.

The structures of messages are shown without comments: [Fields](fields.md) has the meaning of each field.
"""
_HEADERS = {  # in the order in which a program needs them
    "tactiled.hpp": "Receive and command",
    "tactiled_sockets.hpp": "Options, errors and clocks",
    "tactiled_items.hpp": "Items",
    "tactiled_message.hpp": "Messages",
    "tactiled_events.hpp": "Structures of messages",
    "tactiled_grip_controller.hpp": "Hold an object",
    "tactiled.h": "C interface",
}
_WITHOUT_COMMENTS = "tactiled_events.hpp"
_CLASSES = (Kind.CLASS_DECL, Kind.STRUCT_DECL, Kind.CLASS_TEMPLATE)
_FUNCTIONS = (Kind.FUNCTION_DECL, Kind.FUNCTION_TEMPLATE, Kind.CXX_METHOD, Kind.CONSTRUCTOR, Kind.DESTRUCTOR)
_OTHERS = (Kind.ENUM_DECL, Kind.VAR_DECL, Kind.TYPEDEF_DECL, Kind.TYPE_ALIAS_DECL)


def cpp_page() -> str:
    """Return the public declarations of each header with their comments."""
    return "\n".join([_HEAD, *(_section(header, title) for header, title in _HEADERS.items())])


def _section(header: str, title: str) -> str:
    path = resources.shipped("protocols", "cpp") / header
    language, *standard = ["c"] if path.suffix == ".h" else ["c++", "-std=c++17"]
    arguments = ["-x", language, *standard, "-fparse-all-comments", "-nostdinc", "-nostdinc++"]
    root = Index.create().parse(str(path), [*arguments, "-ferror-limit=0"]).cursor
    comments = takewhile(lambda token: token.kind == TokenKind.COMMENT, root.get_tokens())
    lines = [f"## {title}: {header}", "", _prose("\n".join(token.spelling for token in comments)), ""]
    for group in _groups(_declarations(root, str(path))):
        names = dict.fromkeys(f"`{one.spelling}`" for one in group)
        meanings = dict.fromkeys(_prose(one.raw_comment or "") for one in group)  # overloads share theirs
        code = [_text(one, path.read_bytes(), header == _WITHOUT_COMMENTS) for one in group]
        lines += [f"### {', '.join(names)}", "", *meanings, "", f"```{language}", *code, "```", ""]
    return "\n".join(lines)


def _declarations(around: Cursor, path: str) -> Iterator[Cursor]:
    """Yield what a file declares outside the namespace `detail`."""
    for child in around.get_children():
        if child.location.file is None or child.location.file.name != path:
            continue
        if child.kind == Kind.NAMESPACE and child.spelling != "detail":
            yield from _declarations(child, path)
        elif child.kind in (*_FUNCTIONS, *_OTHERS) or (child.kind in _CLASSES and child.is_definition()):
            yield child


def _groups(declarations: Iterator[Cursor]) -> list[list[Cursor]]:
    """Put together what has one name, and what stands under one comment without a blank line between."""
    groups: dict[str, list[Cursor]] = {}
    name, last_line = "", 0
    for one in declarations:
        if one.raw_comment or one.extent.start.line > last_line + 1:
            name = one.spelling
        groups.setdefault(name, []).append(one)
        last_line = one.extent.end.line
    return list(groups.values())


def _text(declaration: Cursor, source: bytes, without_comments: bool) -> str:
    """Return a declaration as it is written, without what `_cuts` yields."""
    start, end = declaration.extent.start.offset, declaration.extent.end.offset
    if declaration.kind in _OTHERS:  # the extent lacks the value of a constant whose type is not known
        end = source.index(b";", end - 1)
    cuts = list(_cuts(declaration))
    if without_comments:
        tokens = (token for token in declaration.get_tokens() if token.kind == TokenKind.COMMENT)
        cuts += [(token.extent.start.offset, token.extent.end.offset, b"") for token in tokens]
    text = source[:end]
    for first, last, instead in sorted(cuts, reverse=True):
        text = text[:first].rstrip() + instead + text[last:]
    words = re.sub(r"(\)|const); {2,}//", r"\1;  //", text[start:].decode())
    return words if words.endswith(";") else f"{words};"


def _cuts(declaration: Cursor) -> Iterator[tuple[int, int, bytes]]:
    """Yield where private members and bodies of functions begin and end, and what replaces them."""
    end = declaration.extent.end.offset
    if declaration.kind in _FUNCTIONS:
        depth = 0  # of parentheses: default values may have braces
        for token in declaration.get_tokens():
            depth += {"(": 1, ")": -1}.get(token.spelling, 0)
            if depth == 0 and token.spelling in ("{", ":"):
                yield token.extent.start.offset, end, b";"
                return
    elif declaration.kind in _CLASSES:
        hidden = None
        for child in declaration.get_children():
            if child.kind == Kind.CXX_ACCESS_SPEC_DECL:
                is_public = child.access_specifier == AccessSpecifier.PUBLIC
                if hidden is None and not is_public:
                    hidden = child.extent.start.offset
                elif hidden is not None and is_public:
                    yield hidden, child.extent.start.offset, b"\n\n"
                    hidden = None
            elif hidden is None:
                yield from _cuts(child)
        if hidden is not None:
            yield hidden, end - 1, b"\n"


def _prose(comment: str) -> str:
    """Return a comment as Markdown: without its marks, and with links to the pages that it names."""
    words = re.sub(r"^ *(?:/\*|//|\*(?!/)) ?| *\*/$", "", comment, flags=re.MULTILINE)
    return re.sub(r"\b(?:docs|protocols)/[\w-]+\.md\b", r"[\g<0>](../\g<0>)", words)
