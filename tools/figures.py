"""Put measured tables into pages, and check numbers of the pages against them: ``python -m tools.figures``.

A figure is a file that ``./run bench NAME --json docs/figures/NAME.json`` writes. The figure ``research`` is
the table of research/README.md, written by hand. Pages name figures in two ways:

- ``<!-- figure: NAME -->`` and ``<!-- end -->``: texts and tables of the figure, which this command writes,
  stand between them. ``<!-- figure: NAME: PART / PART; PART -->`` has a part of them: the texts and the rows
  (with the headings of the table) in which all parts of a term occur, and the text before each such table.
- ``<!-- from NAME: PART / PART; PART = 1 4 least -->``: the numbers before it are those of the figure, back
  to the comment before, or else to the beginning of the paragraph, list item or table row. Each term between
  semicolons selects the texts and cells in whose title, row or heading all of its parts occur, each from
  the beginning of a word on. Then follows, for each number of the page, its place in the selection: numbers
  are counted through the selected texts and cells; of each cell, first those of the first cell of its row,
  then those of its heading, then its own. ``least`` and ``most`` are the extremes of the cells alone, without
  what is in parentheses or follows a slash. This command fills in places if they are missing (see whether
  it chose what is meant), and later writes the numbers of new figures into the page (see whether the
  sentence still holds). The interval of a proportion (see `interval`) may follow it in brackets, as in "48 of
  68 [59 to 80 %]".
- ``<!-- from elsewhere -->``: the numbers before it are of no figure.

With ``--check`` it writes nothing, and fails where pages and figures differ. Tables that it writes have the
interval after each proportion.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

from tools.site.pages import ROOT, pages

CHANGED = " The measured code has changed since."
UNKNOWN = " The measured code may have changed since."  # where the history has no such commit
# Pages that explain comments have them in backticks.
_BLOCK = re.compile(
    r"(?<!`)(<!-- figure: ([^\s:]+)(?:: ([^>]+))? -->\n)(?:(?!<!-- figure: ).)*?(<!-- end -->)", re.DOTALL
)
_EDGE = re.compile(r"(?<!`)<!-- (?:figure: .*?|end) -->")
_MARK = re.compile(r"(?<!`)<!-- from (\S+): ([^>=]+?)(?:\s+=\s+([^>=]+?))?\s+-->")
_OTHER = re.compile(
    r"(?<!`)<!--(?! figure: [^\s:]+(?:: [^>]+)? -->| end -->| from elsewhere -->| from \S+: [^>]+\s-->)"
)
_BEGINNING = re.compile(r"<!--.*?-->|\n\s*\n|\n(?=\s*(?:[-|#>] |\d+\. ))", re.DOTALL)  # of what a mark covers
_NOT_WORDS = re.compile(r"`[^`]*`|\]\([^)]*\)|\A\s*\d+\. ")  # code, addresses of links, number of a list item
_NUMBER = re.compile(r"(?<!\w)[-\u2212]?\d+(?:,\d{3})*(?:\.\d+)?")
_Z = 1.96  # quantile of 97.5 % of a normal variable
_RATIO = re.compile(r"(?<!\w)(\d+(?:,\d{3})*) of (\d+(?:,\d{3})*)(?!,?\d|\.\d| ?%)")
_INTERVAL = re.compile(r"(?<=\d) \[[\d.]+ to [\d.]+ %\]")
_RATIO_WITH_INTERVAL = re.compile(rf"({_RATIO.pattern}){_INTERVAL.pattern}")


@dataclass(frozen=True)
class Figure:
    """Content of one file; None is what is not known."""

    command: str
    commit: str | None
    date: str | None
    machine: Mapping[str, Any] | None
    note: str | None  # on this measurement, written by hand
    code: list[str]  # paths of what was measured
    sections: list[str | list[dict[str, str]]]  # texts; tables as rows, which map headings to cells
    answers: Mapping[str, list[float]] | None = None  # to a few inputs; a test compares those of today

    def block(self, terms: list[str]) -> str:
        """Return what a page shows."""
        shown = "\n\n".join(self.shown(terms))
        explained = " In brackets: 95 % interval of the proportion." if "%]" in shown else ""
        return f"> {self._head()}{explained}\n\n{shown}"

    def shown(self, terms: list[str]) -> list[str]:
        """Return the texts and tables, or what terms select of them."""
        text, shown = "", list[str]()
        for section in self.sections:
            if isinstance(section, str):
                text = section
                if not terms or _matches(text, terms):
                    shown.append(text)
                continue
            rows = [row for row in section if not terms or _matches(" ".join([*row, *row.values()]), terms)]
            if rows or not terms:
                shown += [_table(rows)] if text in ["", *shown] else [text, _table(rows)]
        return shown

    def selected(self, term: str) -> list[str]:
        """Return the numbers at a term, in the order in which places count them."""
        return [one for words, _ in self._places(term) for one in numbers(words)]

    def cells(self, term: str) -> list[str]:
        """Return the numbers of the cells at a term, without what is in parentheses or follows a slash."""
        return [
            one for _, cell in self._places(term) for one in numbers(re.sub(r"\([^)]*\)| / .*", "", cell))
        ]

    def _places(self, term: str) -> Iterator[tuple[str, str]]:
        """Yield the words that have the numbers, and the cell, of texts and cells at a term.

        If the last part of the term is in headings, cells are those of these columns.
        """
        title, last = "", term.split(" / ")[-1]
        for section in self.sections:
            if isinstance(section, str):
                title = section
                if _matches(title, [term]):
                    yield title, title
                continue
            for row in section:
                label, *_ = row.values()
                columns = [heading for heading in row if _matches(heading, [last])] or list(row)
                for heading in columns:
                    if _matches(" ".join([title, *row.values(), heading]), [term]):
                        yield f"{label} {heading} {row[heading]}", row[heading]

    def _head(self) -> str:
        commit, date = (self.commit or "not known")[:9], (self.date or "not known")[:10]
        commit += " with changes" if (self.commit or "").endswith("-dirty") else ""
        words = [f"`{self.command}`", f"commit {commit}", f"date {date}"]
        if self.machine:
            words.append(
                "{processor}, {processors} processors, load average {load_average:.1f}, "
                "path of a scan: {path_of_a_scan}".format(**self.machine)
            )
        return f"{'; '.join(words)}.{f' {self.note}' if self.note else ''}{self._age()}"

    def _age(self) -> str:
        """Say whether a later commit touched what was measured."""
        if not self.commit:
            return UNKNOWN
        later = f"{self.commit.removesuffix('-dirty')}..HEAD"
        git = ["git", "-C", str(ROOT), "rev-list", "-1", later, "--", *self.code]
        found = subprocess.run(git, capture_output=True, text=True, check=False)
        return UNKNOWN if found.returncode else CHANGED if found.stdout else ""


def _matches(place: str, terms: list[str]) -> bool:
    """Say whether all parts of one of the terms occur, each from the beginning of a word on."""
    return any(
        all(re.search(rf"(?<!\w){re.escape(part)}", place) for part in term.split(" / ")) for term in terms
    )


def _terms(text: str) -> list[str]:
    return " ".join(text.split()).split("; ")


def load_figures(folder: Path = ROOT / "docs" / "figures") -> dict[str, Figure]:
    """Read all figures, by name; an error names the file."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        try:
            found[path.stem] = Figure(**json.loads(path.read_text("utf-8")))
        except (json.JSONDecodeError, TypeError) as error:
            sys.exit(f"{path}: {error}; `./run bench NAME --json FILE` writes such files")
    return found


def research(page: Path = ROOT / "research" / "README.md") -> Figure:
    """Read the table of what was measured by benches of former versions, or by hand."""
    text = page.read_text("utf-8")
    lines = [
        re.split(r"\s*\|\s*", line.strip()[1:-1].strip()) for line in text.splitlines() if line[:1] == "|"
    ]
    for cells in lines:
        if len(cells) != len(lines[0]):
            sys.exit(f"{page}: the row of {cells[0]} has {len(cells)} cells, its heading {len(lines[0])}")
    rows = [dict(zip(lines[0], cells, strict=True)) for cells in lines[2:]]
    return Figure("former benches", None, None, None, None, [], [rows])


def with_figures(text: str, figures: Mapping[str, Figure]) -> str:
    """Return a page with the tables of the figures that it names."""

    def block(found: re.Match[str]) -> str:
        head, name, terms, end = found.groups()
        if name not in figures:
            return found[0]
        return f"{head}\n{figures[name].block(_terms(terms) if terms else [])}\n\n{end}"

    return _BLOCK.sub(block, text)


class Number(NamedTuple):
    """Number of a page, and where it is."""

    text: str
    start: int
    end: int


class Claim(NamedTuple):
    """Numbers of a page that a comment says to be those of a figure."""

    line: int
    name: str
    terms: list[str]
    numbers: list[Number]
    places: list[str]  # for each number, which one of the figure it is; empty if the comment does not say
    end: int  # where what follows the terms begins

    def known(self, figure: Figure) -> dict[str, str]:
        """Return the numbers of the figure by their places."""
        cells = [one for term in self.terms for one in figure.cells(term)]
        extremes = {"least": min(cells, key=value), "most": max(cells, key=value)} if cells else {}
        selected = (one for term in self.terms for one in figure.selected(term))
        return {str(place): one for place, one in enumerate(selected, 1)} | extremes

    def with_places(self, figure: Figure) -> list[str]:
        """Return the first place of each number, after that of the number before if there is one."""
        known, places, at = self.known(figure), list[str](), 0
        for number in self.numbers:
            same = [int(k) for k, one in known.items() if k.isdigit() and value(one) == value(number.text)]
            at = next((k for k in same if k > at), same[0] if same else 0)
            places.append(str(at))
        return places


def claims(text: str) -> list[Claim]:
    """List the claims of a page."""
    found = []
    for mark in _MARK.finditer(text):
        said = _BEGINNING.split(text[: mark.start()])[-1]
        start, words = mark.start() - len(said), _without_code(_INTERVAL.sub(_blank, said))
        those = [Number(n[0], start + n.start(), start + n.end()) for n in _NUMBER.finditer(words)]
        places = (mark[3] or "").split()
        found.append(Claim(_line(text, mark), mark[1], _terms(mark[2]), those, places, mark.end(2)))
    return found


def with_numbers(text: str, figures: Mapping[str, Figure]) -> str:
    """Return a page with the numbers of its figures, and with places where a comment has none."""
    for claim in reversed(claims(text)):
        if (figure := figures.get(claim.name)) is None or not claim.numbers:
            continue
        if not claim.places:
            text = f"{text[: claim.end]} = {' '.join(claim.with_places(figure))}{text[claim.end :]}"
        known = claim.known(figure)
        if len(claim.places) == len(claim.numbers) and all(place in known for place in claim.places):
            for number, place in reversed(list(zip(claim.numbers, claim.places, strict=True))):
                if value(number.text) != value(known[place]):
                    text = text[: number.start] + known[place] + text[number.end :]
    return _RATIO_WITH_INTERVAL.sub(lambda one: f"{one[1]} {interval(one[2], one[3])}".rstrip(), text)


def problems(text: str, figures: Mapping[str, Figure]) -> Iterator[str]:
    """Yield where a page differs from the figures: the line, and what is wrong."""
    for other in _OTHER.finditer(text):
        yield f"{_line(text, other)}: this comment is none of those that tools/figures.py explains"
    for ratio in _RATIO_WITH_INTERVAL.finditer(text):
        if ratio[0] != f"{ratio[1]} {interval(ratio[2], ratio[3])}".rstrip():
            yield f"{_line(text, ratio)}: the interval of {ratio[1]} is {interval(ratio[2], ratio[3])}"
    paired = {place for block in _BLOCK.finditer(text) for place in (block.start(), block.start(4))}
    for edge in _EDGE.finditer(text):
        if edge.start() not in paired:
            yield f"{_line(text, edge)}: `{edge[0]}` has no other end, or is not alone on its line"
    for block in _BLOCK.finditer(text):
        line, file = _line(text, block), f"docs/figures/{block[2]}.json"
        if block[2] not in figures:
            yield f"{line}: there is no {file}"
            continue
        for term in _terms(block[3]) if block[3] else []:
            if not figures[block[2]].shown([term]):
                yield f"{line}: {file} has nothing at `{term}`"
        if _ageless(with_figures(block[0], figures)) != _ageless(block[0]):
            yield f"{line}: differs from {file}; run `python -m tools.figures`"
    for claim in claims(text):
        yield from (f"{claim.line}: {words}" for words in _problems_of(claim, figures))


def _problems_of(claim: Claim, figures: Mapping[str, Figure]) -> Iterator[str]:
    file = "research/README.md" if claim.name == "research" else f"docs/figures/{claim.name}.json"
    at = f"at `{'; '.join(claim.terms)}`"
    if (figure := figures.get(claim.name)) is None:
        yield f"there is no {file}"
        return
    for term in claim.terms:
        if not figure.selected(term):
            yield f"{file} has no number at `{term}`"
    known, said = claim.known(figure), [number.text for number in claim.numbers]
    if len(claim.places) != len(said):
        yield f"{len(claim.places)} places {at} of {file} for {len(said)} numbers: {', '.join(said)}"
        return
    for number, place in zip(said, claim.places, strict=True):
        if place not in known:
            yield f"{number}: {file} has no place {place} {at}"
        elif value(number) != value(known[place]):
            yield f"{number} is {known[place]} in {file} {at}"


def with_intervals(text: str) -> str:
    """Return the text with its interval after each "A of B"."""
    return _RATIO.sub(lambda ratio: f"{ratio[0]} {interval(ratio[1], ratio[2])}".rstrip(), text)


def interval(part: str, whole: str) -> str:
    """Return the 95 % interval of a proportion (Wilson 1927, equation 4); it holds for independent trials."""
    found, n = (int(one.replace(",", "")) for one in (part, whole))
    if not 0 <= found <= n or not n:
        return ""
    p, z2 = found / n, _Z**2
    middle, half = p + z2 / (2 * n), _Z * sqrt(p * (1 - p) / n + z2 / (4 * n**2))
    low, high = (100 * max(0.0, bound) / (1 + z2 / n) for bound in (middle - half, middle + half))
    digits = 1 if min(high, 100 - low) < 2 else 0  # near 0 or 1, it is narrow
    return f"[{low:.{digits}f} to {high:.{digits}f} %]"


def numbers(text: str) -> list[str]:
    """Return the numbers of a text, as they stand. Code and addresses have none, nor has a list item."""
    return _NUMBER.findall(_without_code(text))


def value(number: str) -> float:
    """Return a number of a text; `11,791` is 11791."""
    return float(number.replace(",", "").replace("\u2212", "-"))


def _without_code(text: str) -> str:
    return _NOT_WORDS.sub(_blank, text)


def _blank(found: re.Match[str]) -> str:
    return " " * len(found[0])


def _ageless(text: str) -> str:
    """Return the text without what depends on later commits."""
    return text.replace(CHANGED, "").replace(UNKNOWN, "")


def _table(rows: list[dict[str, str]]) -> str:
    if not rows:
        return "(no rows)"
    lines = [
        list(rows[0]),
        ["---"] * len(rows[0]),
        *([with_intervals(cell) for cell in row.values()] for row in rows),
    ]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _line(text: str, match: re.Match[str]) -> int:
    return text.count("\n", 0, match.start()) + 1


def main(arguments: list[str]) -> None:
    """Write the tables, or check with ``--check``."""
    if arguments not in ([], ["--check"]):
        sys.exit("usage: python -m tools.figures [--check]")
    figures, n_numbers, wrong = load_figures() | {"research": research()}, 0, list[str]()
    for path in pages():
        text = path.read_text("utf-8")
        written = text if "--check" in arguments else with_figures(with_numbers(text, figures), figures)
        if written != text:
            path.write_text(written, "utf-8")
            print(f"{path.relative_to(ROOT)}: written")
            text = written
        wrong += [f"{path.relative_to(ROOT)}:{problem}" for problem in problems(text, figures)]
        n_numbers += sum(len(claim.numbers) for claim in claims(text))
    print(f"figures: {n_numbers} numbers of sentences and tables are checked against docs/figures")
    if wrong:
        sys.exit("\n".join(wrong))


if __name__ == "__main__":
    main(sys.argv[1:])
