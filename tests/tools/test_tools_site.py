"""The site of ``./run docs``: the pages of the repository, and the reference from the code."""

import json
import re
from pathlib import Path

import pytest

from tactiled.cli.packages import VERBS
from tactiled.daemon.operations.metrics import METRICS
from tactiled.zenoh.fleet import FLEET_METRICS
from tools.site.cpp_reference import cpp_page
from tools.site.field_comments import comment_of, description_of
from tools.site.pages import (
    ROOT,
    folder_page,
    linked,
    repository_files,
    with_four_column_lists,
    with_links_to_pages,
)
from tools.site.reference import fields_page, figures_page, metrics_page, options_page, verbs_page


def test_the_site_has_each_page_and_what_it_links_to_at_its_place() -> None:
    files = repository_files()
    pages = [source for source in files.values() if isinstance(source, Path) and source.suffix == ".md"]
    targets = {str(target.relative_to(ROOT)) for target in linked(pages)}
    assert {"README.md", "docs/slip.md", "protocols/events.md", "docs/demo.png"} <= files.keys()
    assert {place for place in targets if place not in files and f"{place}/index.md" not in files} == set()


def test_a_link_to_a_folder_leads_to_the_page_of_its_files() -> None:
    text = "[all](figures) [one](slip.md#settings) [folder](../protocols/c/)"
    expected = "[all](figures/index.md) [one](slip.md#settings) [folder](../protocols/c/index.md)"
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


def test_verbs_of_all_distributions_are_in_the_reference_with_their_options() -> None:
    sections = {part.split("\n")[0]: part for part in verbs_page().split("\n## ")}
    assert {f"tactiled {entry.replace('.', ' ')}" for entry in VERBS} <= sections.keys()
    assert "--max-tilt" in sections["tactiled detect"]
    assert "--commander" in sections["tactiled keys fleet"]
    assert all("Usage: tactiled" in text for name, text in sections.items() if name != "# Verbs")


@pytest.mark.parametrize(
    ("table", "row"),
    [
        (
            "samples.clock",
            "| `window_buckets` | integer, >= 3, <= 300 | `120` | number of buckets in the fit |",
        ),
        ("port", "| `url` | text | required | Serial port"),
        (
            "publish",
            '| `endpoints` | list of texts | `["tcp://127.0.0.1:9872", "ipc://{runtime}/events.ipc"]` |',
        ),
        ("detect.texture", '| `preset` | `"quick"`, `"balanced"`, `"fine"` | `"balanced"` |'),
        ("detect.grip.contact", "| `contact_volts` | number, > 0 |  |"),
    ],
)
def test_an_option_is_in_the_reference_with_values_default_and_meaning(table: str, row: str) -> None:
    (section,) = [part for part in options_page().split("\n## ") if part.startswith(f"[{table}]")]
    assert f"\n{row}" in section


@pytest.mark.parametrize(
    ("topic", "row"),
    [
        ("slip", "| `state` | `onset`, `end` | onset: a slip begins,"),
        ("slip", "| `taxels` | list of integers | Indices"),
        ("texture", "| `candidates.weight` | number | Weight"),
        ("status", "| `sent.scan` | integer | Messages of scan"),
    ],
)
def test_a_field_is_in_the_reference_with_type_and_meaning(topic: str, row: str) -> None:
    (section,) = [part for part in fields_page().split("\n## ") if part.startswith(f"{topic}\n")]
    assert f"\n{row}" in section
    assert "| `run` |" not in section


def test_every_metric_is_in_the_reference() -> None:
    daemon, fleet = metrics_page().split("\n## Fleet\n")
    assert all(f"| `tactiled_{name}` | {metric.kind} |" in daemon for name, metric in METRICS.items())
    assert all(f"| `tactiled_{name}` | gauge |" in fleet for name in FLEET_METRICS)


def test_every_public_class_of_the_headers_is_in_the_reference_without_what_is_private() -> None:
    sections = {part.split("\n")[0].split(": ")[-1]: part for part in cpp_page().split("\n## ")}
    inner = {"tactiled_catchup.hpp", "tactiled_inbox.hpp", "tactiled_values.hpp"}
    headers = {path.name: path.read_text() for path in (ROOT / "protocols/cpp").glob("*.h*")}
    for header in headers.keys() - inner:
        text = re.sub(r"(?ms)^namespace detail {.*?^}  // namespace", "", headers[header])
        names = re.findall(r"(?m)^(?:class|struct|enum class|enum) (\w+)[^;]*{$", text)
        assert names, header
        assert [name for name in names if f"\n### `{name}`\n" not in sections[header]] == []
    page = "\n".join(sections.values())
    assert not re.search(r"(?m)private:|\w_[;.({]|^ +return|### `(Descriptor|Head)`", page)


@pytest.mark.parametrize(
    ("header", "lines"),
    [
        ("tactiled.hpp", "    const Item* next(double until_s = INF);\n"),
        ("tactiled.hpp", "    std::uint64_t lost() const;  // messages that cannot be recovered\n"),
        ("tactiled_items.hpp", "    double silent_s = 0.0;    // STALE: age of the newest data\n};\n"),
        ("tactiled_events.hpp", "    std::vector<std::int64_t> taxels;\n    std::string detector;\n"),
        ("tactiled_sockets.hpp", "\nNow in seconds of CLOCK_MONOTONIC"),
        ("tactiled.h", "\n### `tactiled_topic`, `tactiled_board`, `tactiled_reason`, `tactiled_count`\n"),
    ],
)
def test_declarations_are_in_the_reference_as_they_are_written(header: str, lines: str) -> None:
    (section,) = [part for part in cpp_page().split("\n## ") if part.split("\n")[0].endswith(f": {header}")]
    assert lines in section


@pytest.mark.parametrize(
    ("lines", "meaning"),
    [
        (["x: int = 0  # metres"], "metres"),
        (["# Of the", "# board", "x: int"], "Of the board"),
        (["y: int = 0  # metres", "x: int"], ""),
        (["x: int = f()  # type: ignore[misc]"], ""),
    ],
)
def test_the_meaning_of_a_field_is_its_comment(lines: list[str], meaning: str) -> None:
    indented = [f"    {line}" for line in lines]
    assert comment_of(indented[:-1], indented[-1]) == meaning


def test_the_meaning_of_an_option_is_its_description() -> None:
    assert description_of("Field(default=0, description='speed, ' 'mm/s')") == "speed, mm/s"
    assert description_of("Field(default=0)") == description_of("0") == description_of("None") == ""


def test_all_figures_are_on_one_page_with_their_misses() -> None:
    page = figures_page()
    for path in ROOT.glob("docs/figures/*.json"):
        _, own = page.split(f"## [{path.stem}]({path.name})\n", 1)
        own = own.split("\n## [", 1)[0]
        figure = json.loads(path.read_text())
        assert figure["command"] in own
        assert own.count("MISSED") == json.dumps(figure["sections"]).count("MISSED")
