"""The site of ``./run docs``: pages that hosts of git repositories show as well."""

from pathlib import Path

import pytest

from tools.site.pages import (
    ROOT,
    folder_page,
    linked,
    repository_files,
    with_four_column_lists,
    with_links_to_pages,
)


def test_the_site_has_each_page_and_what_it_links_to_at_its_place() -> None:
    files = repository_files()
    pages = [source for source in files.values() if isinstance(source, Path) and source.suffix == ".md"]
    targets = {str(target.relative_to(ROOT)) for target in linked(pages)}
    assert {"README.md", "docs/slip.md", "protocols/events.md", "docs/demo.png"} <= files.keys()
    assert {place for place in targets if place not in files and f"{place}/index.md" not in files} == set()


def test_a_link_to_a_folder_leads_to_the_page_of_its_files() -> None:
    text = "[all](decisions) [one](slip.md#settings) [folder](../protocols/c/)"
    expected = "[all](decisions/index.md) [one](slip.md#settings) [folder](../protocols/c/index.md)"
    assert with_links_to_pages(text, ROOT / "docs/trust.md") == expected


def test_the_page_of_a_folder_names_its_pages_by_title(tmp_path: Path) -> None:
    folder = tmp_path / "docs"
    (folder / "inner").mkdir(parents=True)
    (folder / "a.md").write_text("# A title\n\ntext\n")
    (folder / "b.c").write_text("int main;\n")
    (folder / ".hidden").write_text("")
    assert folder_page(folder) == "# docs/\n\n- [A title](a.md)\n- [b.c](b.c)\n- `inner/`\n"


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("1. a\n\n       code\n", "1. a\n\n        code\n"),
        ("- a\n  b\n  - c\n", "- a\n    b\n    - c\n"),
        ("- a\n\ntext\n  text\n", "- a\n\ntext\n  text\n"),
        ("```\n- a\n  b\n```\n  c\n", "```\n- a\n  b\n```\n  c\n"),
        ("10. a\n\n    b\n", "10. a\n\n    b\n"),
    ],
)
def test_items_of_lists_are_indented_by_four_columns(written: str, read: str) -> None:
    assert with_four_column_lists(written) == read
