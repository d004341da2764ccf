"""Pages for readers, README and docs: links lead somewhere, commands exist. Class names are unique."""

import ast
import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest

from bench.__main__ import BENCHES
from tactiled.cli.entry import cli
from tactiled.cli.packages import DeferredCommand
from tools.figures import claims

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/*.md", "protocols/*.md", "research/*.md")
    for page in ROOT.glob(pattern)
)
README = (ROOT / "README.md").read_text()
every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def anchors(page: Path) -> set[str]:
    """Names that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def commands(text: str) -> list[str]:
    """Command lines of a page: indented or fenced lines, and code in backticks, that begin with a verb."""
    blocks = re.findall(r"^ {4,}(?:sudo )?((?:tactiled|\./run) .+)$", text, re.MULTILINE)
    inline = re.findall(r"`((?:tactiled|\./run) [^`]+)`", text.replace("\n", " "))
    return [line.split("  #")[0].strip() for line in (*blocks, *inline)]


def verb_of(group: click.Group, name: str) -> click.Command:
    """Verb of a group, also of one that another distribution brings."""
    command = group.get_command(click.Context(group), name)
    assert command is not None, name
    return command.load() if isinstance(command, DeferredCommand) else command


@every_page
def test_relative_links_and_their_anchors_exist(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?://)([^)\s]+)\)", page.read_text()):
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), target
        if anchor and linked.suffix == ".md":
            assert anchor in anchors(linked), target


@every_page
def test_commands_and_their_options_exist(page: Path) -> None:
    for line in commands(page.read_text()):
        program, verb, *words = shlex.split(line)
        own = ("test", "cover", "lint", "train", "docs", "release")
        if verb in ("VERB", "ANYTHING") or (program == "./run" and verb in own):
            continue
        if program == "./run" and verb == "bench":
            assert words[0] in (*BENCHES, "NAME"), line
            continue
        command = verb_of(cli, verb)
        if isinstance(command, click.Group):
            command = verb_of(command, words[0])
        known = {option for each in command.params for option in (*each.opts, *each.secondary_opts)}
        assert {word for word in words if re.fullmatch(r"--?[a-z][\w-]*", word)} <= known | {"--help"}, line


def test_readme_is_short() -> None:
    assert len(README.splitlines()) <= 120


def test_every_page_has_a_link_in_readme() -> None:
    linked = set(re.findall(r"\]\(([^)#]+)", README))
    assert {f"docs/{page.name}" for page in ROOT.glob("docs/*.md")} - linked == set()


def test_each_question_of_readme_has_numbers_of_a_figure() -> None:
    rows = re.findall(r"^\| \[[^\]]+\]\([^)]*\) \|.+$", README, re.MULTILINE)
    assert 1 <= len(rows) <= 10
    assert [row for row in rows if not claims(row)] == []


def test_readme_counts_the_data_sets_of_others() -> None:
    catalogue = tomllib.loads((ROOT / "bench/recordings/catalogue.toml").read_text())
    addresses = {source["address"] for source in catalogue["source"]}
    assert f"{len(addresses)} published data sets of other groups" in README


def test_a_class_name_occurs_once_in_the_package() -> None:
    places: dict[str, list[str]] = {}
    for path in sorted([*ROOT.glob("tactiled/**/*.py"), *ROOT.glob("packages/*/tactiled/**/*.py")]):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
