"""Files of the repository that the site shows, at their places in the repository.

A page keeps its place, so its relative links hold on the site as they do on a host of git repositories. What
a page links to is taken in as well: a file as it is, and a folder as a list of its files.
"""

import os
import re
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_PAGES = ("*.md", "docs/*.md", "protocols/*.md", "research/*.md")
_LINK = re.compile(r"(\]\()(?!\w+:|#)([^)\s#]+)")  # of Markdown, to a file of the repository


def pages() -> list[Path]:
    """List the pages of the repository."""
    return sorted(page for pattern in _PAGES for page in ROOT.glob(pattern))


def repository_files() -> dict[str, Path | str]:
    """Return what the site shows, by its place: files, and texts of pages that list a folder."""
    shown = set(pages())
    lists: dict[str, Path | str] = {}
    for target in linked(shown):
        if target.is_dir():
            lists[f"{target.relative_to(ROOT)}/index.md"] = folder_page(target)
            shown.update(path for path in _listed(target) if path.is_file())
        else:
            shown.add(target)
    return {**lists, **{str(path.relative_to(ROOT)): path for path in sorted(shown)}}


def linked(pages: Iterable[Path]) -> set[Path]:
    """Return the files and folders that pages link to."""
    targets = (
        Path(os.path.normpath(page.parent / target))
        for page in pages
        for _, target in _LINK.findall(page.read_text())
    )
    return {target for target in targets if target.exists()}


def folder_page(folder: Path) -> str:
    """Return a page that lists a folder: pages by title, other files by name."""
    return "\n".join([f"# {folder.name}/", "", *(f"- {_entry(path)}" for path in _listed(folder)), ""])


def with_links_to_pages(text: str, place: Path) -> str:
    """Return the text of the page at `place`, with links to folders led to the pages that list them."""

    def to_page(link: re.Match[str]) -> str:
        is_folder = (place.parent / link[2]).is_dir()
        return f"{link[1]}{link[2].rstrip('/')}/index.md" if is_folder else link[0]

    return _LINK.sub(to_page, text)


def with_four_column_lists(text: str) -> str:
    """Return a page whose list items are indented by four columns, as Python-Markdown needs it.

    On hosts of git repositories an item is indented as far as its first word, by two or three columns.
    """
    lines, indent, is_code = [], 0, False
    for line in text.split("\n"):
        if line.startswith("```"):
            is_code = not is_code
        elif is_code:
            pass
        elif item := re.match(r"(?:- |\d+\. ) *", line):
            indent = max(0, 4 - len(item[0]))
        elif line and not line.startswith(" "):
            indent = 0
        elif line:
            line = " " * indent + line
        lines.append(line)
    return "\n".join(lines)


def _listed(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if not path.name.startswith(("_", ".")))


def _entry(path: Path) -> str:
    if path.is_dir():
        return f"`{path.name}/`"
    title = re.match(r"# (.+)\n", path.read_text()) if path.suffix == ".md" else None
    return f"[{title[1] if title else path.name}]({path.name})"
