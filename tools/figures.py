"""Put measured tables into pages, and check numbers of the pages against them: ``python -m tools.figures``.

A figure is a file that ``./run bench NAME --json docs/figures/NAME.json`` writes. Pages name it in two ways:

- ``<!-- figure: NAME -->`` and ``<!-- end -->``: texts and tables of the figure, which this command writes,
  stand between them. ``<!-- figure: NAME: PART / PART; PART -->`` has a part of them: the texts and the rows
  (with the headings of the table) in which all parts of a term occur, and the text before each such table.
- ``<!-- from NAME: PART / PART; PART -->``: the numbers before it are those of the figure, back to the
  comment before, or else to the beginning of the paragraph, list item or table row. Each term between
  semicolons selects the texts and cells in whose title, row or heading all of its parts occur, each from
  the beginning of a word on. Each number must be in a selected text or cell, in the heading of such a cell
  or in the first cell of its row. Of rows of aims, one number of the results must be among them. Where the
  figure has "A of B", so must the page for the same B, in the same order. The interval of a proportion (see
  `interval`) may follow it in brackets, as in "48 of 68 [59 to 80 %]". A term that ends with ``= least`` or
  ``= most`` wants the least or the largest number of the selected cells.
- ``<!-- from elsewhere -->``: the numbers before it are of no figure.

With ``--check`` it writes nothing, and fails where pages and figures differ. Tables that it writes have the
interval after each proportion.
"""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
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
_MARK = re.compile(r"(?<!`)<!-- from (\S+): ([^>]+) -->")
_OTHER = re.compile(
    r"(?<!`)<!--(?! figure: [^\s:]+(?:: [^>]+)? -->| end -->| from elsewhere -->| from \S+: [^>]+ -->)"
)
_BEGINNING = re.compile(r"<!--.*?-->|\n\s*\n|\n(?=\s*(?:[-|#>] |\d+\. ))", re.DOTALL)  # of what a mark covers
_NOT_WORDS = re.compile(r"`[^`]*`|\]\([^)]*\)|\A\s*\d+\. ")  # code, addresses of links, number of a list item
_NUMBER = re.compile(r"(?<!\w)[-\u2212]?\d+(?:,\d{3})*(?:\.\d+)?")
_EXTREMES: Mapping[str, Callable[..., float | None]] = {"least": min, "most": max}
_Z = 1.96  # quantile of 97.5 % of a normal variable
_RATIO = re.compile(r"(?<!\w)(\d+(?:,\d{3})*) of (\d+(?:,\d{3})*)(?!,?\d|\.\d| ?%)")


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

    def select(self, term: str) -> list[str]:
        """Return the texts and cells at a term, each cell with its heading and the first of its row."""
        return [words for place, words, _ in self._places() if _matches(place, [term])]

    def extreme(self, term: str, which: str) -> float | None:
        """Return the least or the largest number of the cells at a term; None without one."""
        found = numbers(" ".join(cell for place, _, cell in self._places() if _matches(place, [term])))
        return _EXTREMES[which](found, default=None)

    def results(self, term: str) -> set[float]:
        """Return the numbers of the results in rows at a term, of tables of aims: what follows the limit."""
        rows = [row for section in self.sections if not isinstance(section, str) for row in section]
        cells = (
            cell
            for row in rows
            if "limit" in row and _matches(" ".join([*row.values(), *row]), [term])
            for heading, cell in row.items()
            if heading not in ("aim", "limit")
        )
        return numbers(" ".join(cells))

    def _places(self) -> Iterator[tuple[str, str, str]]:
        """Yield what terms are looked for in, the words that have the numbers, and the cell, of each cell.

        A text is a cell, too.
        """
        title = ""
        for section in self.sections:
            if isinstance(section, str):
                title = section
                yield title, title, title
                continue
            for row in section:
                label, *_ = row.values()
                for heading, cell in row.items():
                    yield " ".join([title, *row.values(), heading]), f"{label} {heading} {cell}", cell

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


def with_figures(text: str, figures: Mapping[str, Figure]) -> str:
    """Return a page with the tables of the figures that it names."""

    def block(found: re.Match[str]) -> str:
        head, name, terms, end = found.groups()
        if name not in figures:
            return found[0]
        return f"{head}\n{figures[name].block(_terms(terms) if terms else [])}\n\n{end}"

    return _BLOCK.sub(block, text)


class Claim(NamedTuple):
    """Numbers of a page that a comment says to be those of a figure."""

    line: int
    name: str
    terms: list[str]
    numbers: set[float]
    ratios: list[tuple[str, str]]  # "A of B", in the order of the page


def claims(text: str) -> list[Claim]:
    """List the claims of a page."""
    return [
        Claim(
            _line(text, mark),
            mark[1],
            _terms(mark[2]),
            numbers(said := without_intervals(_BEGINNING.split(text[: mark.start()])[-1])),
            _RATIO.findall(said),
        )
        for mark in _MARK.finditer(text)
    ]


def problems(text: str, figures: Mapping[str, Figure]) -> Iterator[str]:
    """Yield where a page differs from the figures: the line, and what is wrong."""
    for other in _OTHER.finditer(text):
        yield f"{_line(text, other)}: this comment is none of those that tools/figures.py explains"
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
    for line, name, terms, said, ratios in claims(text):
        file, known, counted = f"docs/figures/{name}.json", set[float](), list[tuple[str, str]]()
        if name not in figures:
            yield f"{line}: there is no {file}"
            continue
        for term, _, which in (one.partition(" = ") for one in terms):
            selected = figures[name].select(term)
            if which and (which not in _EXTREMES or figures[name].extreme(term, which) not in said):
                yield f"{line}: the {which} of {file} at `{term}` is not said"
            known |= numbers(" ".join(selected))
            counted += _RATIO.findall(" ".join(selected))
            if not selected:
                yield f"{line}: {file} has nothing at `{term}`"
            if (results := figures[name].results(term)) and not results & said:
                yield f"{line}: no result of {file} at `{term}` is said"
        for part, whole in sorted(set(ratios) - set(counted)):
            if whole in {other for _, other in counted}:
                yield f"{line}: {part} of {whole} is not in {file} at `{'; '.join(terms)}`"
        left = iter(counted)
        if not all(one in left for one in ratios if one in counted):
            yield f"{line}: proportions are in another order than in {file} at `{'; '.join(terms)}`"
        for number in sorted(said - known):
            yield f"{line}: {number:g} is not in {file} at `{'; '.join(terms)}`"


def with_intervals(text: str) -> str:
    """Return the text with its interval after each "A of B"."""
    return _RATIO.sub(lambda ratio: f"{ratio[0]} {interval(ratio[1], ratio[2])}".rstrip(), text)


def without_intervals(text: str) -> str:
    """Return the text without the intervals after "A of B" that are right."""
    for ratio in _RATIO.finditer(text):
        text = text.replace(f"{ratio[0]} {interval(ratio[1], ratio[2])}".rstrip(), ratio[0])
    return text


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


def numbers(text: str) -> set[float]:
    """Return the numbers of a text; `11,791` is 11791. Code and addresses have none, nor has a list item."""
    return {
        float(one.replace(",", "").replace("\u2212", "-"))
        for one in _NUMBER.findall(_NOT_WORDS.sub(" ", text))
    }


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
    figures, n_numbers, wrong = load_figures(), 0, list[str]()
    for path in pages():
        text = path.read_text("utf-8")
        if "--check" not in arguments and (written := with_figures(text, figures)) != text:
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
