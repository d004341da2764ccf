"""Pages and figures: edited numbers, figures and cells that do not exist, tables of another figure."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from bench.__main__ import BENCHES
from bench.report import as_json, table
from tools import figures as tool
from tools.figures import (
    CHANGED,
    UNKNOWN,
    Figure,
    claims,
    interval,
    load_figures,
    numbers,
    problems,
    value,
    with_figures,
    with_intervals,
    with_numbers,
)
from tools.site.pages import ROOT

SLIP = Figure(
    command="./run bench slip",
    commit=None,
    date=None,
    machine=None,
    note=None,
    code=["tactiled/detect"],
    sections=[
        "Worlds of laws: 48 cases.",
        [
            {"question": "gross in 300 ms", "fast": "12 of 13", "quiet": "10 of 13"},
            {"question": "onsets an hour", "fast": "1,282", "quiet": "127"},
        ],
    ],
)
KNOWN = {"slip": SLIP}
PAGE = """# Page

- Of 13 gross slips, 10 are reported within 300 ms. <!-- from slip: gross / quiet = 3 2 1 -->
- 7 is measured once <!-- from elsewhere -->, and 1282 onsets come in 48 cases <!-- from slip: onsets / fast;
  laws: 48 = 1 2 -->; 99 is not checked.

| [question](page-5.md) | `77` and words | 127 <!-- from slip: quiet = 4 --> |

<!-- figure: slip -->
<!-- end -->
"""


def written(text: str = PAGE) -> str:
    return with_figures(text, KNOWN)


def test_a_page_as_written_has_no_problem() -> None:
    text = written()
    assert list(problems(text, KNOWN)) == []
    assert "| gross in 300 ms | 12 of 13 [67 to 99 %] | 10 of 13 [50 to 92 %] |\n" in text
    assert with_figures(text, KNOWN) == text
    assert [(claim.line, [number.text for number in claim.numbers]) for claim in claims(text)] == [
        (3, ["13", "10", "300"]),
        (4, ["1282", "48"]),
        (7, ["127"]),
    ]


@pytest.mark.parametrize(
    ("terms", "kept"),
    [
        ("gross", "Worlds of laws: 48 cases.\n\nHEADS\nGROSS"),
        ("quiet / onsets", "Worlds of laws: 48 cases.\n\nHEADS\nONSETS"),
        ("laws", "Worlds of laws: 48 cases."),
        ("laws; onsets; gross", "Worlds of laws: 48 cases.\n\nHEADS\nGROSS\nONSETS"),
    ],
)
def test_a_page_may_have_a_part_of_a_figure(terms: str, kept: str) -> None:
    heads = "| question | fast | quiet |\n| --- | --- | --- |"
    rows = {
        "GROSS": "| gross in 300 ms | 12 of 13 [67 to 99 %] | 10 of 13 [50 to 92 %] |",
        "ONSETS": "| onsets an hour | 1,282 | 127 |",
    }
    for name, row in {"HEADS": heads, **rows}.items():
        kept = kept.replace(name, row)
    text = with_figures(f"<!-- figure: slip: {terms} -->\n<!-- end -->", KNOWN)
    _, head, shown = text.split("\n\n", 2)
    assert shown == f"{kept}\n\n<!-- end -->"
    assert head.endswith("In brackets: 95 % interval of the proportion.") == ("%]" in kept)
    assert list(problems(text, KNOWN)) == []


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ("10 are", "13 are", "3: 13 is 10 in docs/figures/slip.json at `gross / quiet`"),
        ("1282", "1283", "4: 1283 is 1,282 in docs/figures/slip.json at `onsets / fast; laws: 48`"),
        ("127 <", "-127 <", "7: -127 is 127 in docs/figures/slip.json at `quiet`"),
        (
            "= 3 2 1",
            "= 3 2",
            "3: 2 places at `gross / quiet` of docs/figures/slip.json for 3 numbers: 13, 10",
        ),
        (" = 3 2 1", "", "3: 0 places at `gross / quiet` of docs/figures/slip.json for 3 numbers: 13, 10"),
        ("= 3 2 1", "= 3 2 4", "3: 300: docs/figures/slip.json has no place 4 at `gross / quiet`"),
        ("= 3 2 1", "= 3 2 best", "3: 300: docs/figures/slip.json has no place best at `gross / quiet`"),
        ("from slip: gross", "from skid: gross", "3: there is no docs/figures/skid.json"),
        ("gross / quiet", "gross / loud", "3: docs/figures/slip.json has no number at `gross / loud`"),
        ("figure: slip", "figure: skid", "9: there is no docs/figures/skid.json"),
        ("| 1,282 |", "| 1,283 |", "9: differs from docs/figures/slip.json; run `python -m tools.figures`"),
        ("<!-- from slip: quiet", "<!-- form slip: quiet", "7: this comment is none of those"),
        ("from slip: gross", "from slip: ross", "3: docs/figures/slip.json has no number at `ross / quiet`"),
        ("figure: slip -->", "figure: slip: gross -->", "9: differs from docs/figures/slip.json"),
        ("figure: slip -->", "figure: slip: loud -->", "9: docs/figures/slip.json has nothing at `loud`"),
        ("figure: slip -->", "figure: slip --> ", "9: `<!-- figure: slip -->` has no other end"),
        ("<!-- figure: slip -->\n", "", "19: `<!-- end -->` has no other end"),
    ],
)
def test_an_edit_of_one_place_is_found_at_its_line(right: str, wrong: str, said: str) -> None:
    text = written()
    assert right in text
    assert any(problem.startswith(said) for problem in problems(text.replace(right, wrong, 1), KNOWN))


@pytest.mark.parametrize(
    ("ratio", "bounds"),  # by hand: (p + z^2/2n -+ z sqrt(pq/n + z^2/4n^2)) / (1 + z^2/n) with z = 1.96
    [("10 of 13", "[50 to 92 %]"), ("1 of 1000", "[0.0 to 0.6 %]"), ("24 of 24", "[86 to 100 %]")],
)
def test_the_interval_of_a_proportion(ratio: str, bounds: str) -> None:
    assert interval(*ratio.split(" of ")) == bounds
    assert with_intervals(f"{ratio}, 7 ms") == f"{ratio} {bounds}, 7 ms"
    assert interval("3", "0") == interval("14", "13") == ""


@pytest.mark.parametrize(
    ("said", "at", "is_right"),
    [
        ("127 at best", "onsets = least", True),
        ("1,282 at worst", "onsets = most", True),
        ("1,282 at best", "onsets = least", False),
        ("127 at worst", "onsets = most", False),
        ("1,282 and 127", "onsets = 1 2", True),
        ("127 and 1,282", "onsets = 1 2", False),
        ("12 of 13 and 10 of 13", "gross / fast; gross / quiet = 2 3 5 6", True),
        ("10 of 13 and 12 of 13", "gross / fast; gross / quiet = 2 3 5 6", False),
    ],
)
def test_a_number_of_the_same_cells_is_not_another_one(said: str, at: str, is_right: bool) -> None:
    page = f"{said} <!-- from slip: {at} -->"
    assert (not list(problems(page, KNOWN))) is is_right
    assert not list(problems(with_numbers(page, KNOWN), KNOWN))  # as the figure has them


def test_places_are_filled_in_and_numbers_follow_their_figure() -> None:
    page = "Of 13, 10 [50 to 92 %] within 300 ms: 10 of 13 [50 to 92 %]. <!-- from slip: gross / quiet -->"
    filled = with_numbers(page, KNOWN)
    assert filled == page.replace(" -->", " = 3 2 1 2 3 -->")
    assert not list(problems(filled.replace("10 [50 to 92 %]", "10"), KNOWN))
    table = [{"question": "gross in 300 ms", "fast": "12 of 13", "quiet": "9 of 14"}]
    later = {"slip": replace(SLIP, sections=[table])}
    assert "Of 14, 9" in with_numbers(filled, later)
    assert "9 of 14 [39 to 84 %]" in with_numbers(filled, later)


def test_the_last_part_of_a_term_chooses_columns_that_it_names() -> None:
    rows = [{"aim": "grip as measured", "limit": "at most 1.4", "measured": "MISSED: 2.02 (3.5)"}]
    known = {"hold": replace(SLIP, sections=[rows])}
    assert with_numbers("2.02 <!-- from hold: grip / measured -->", known).endswith("measured = 1 -->")
    assert with_numbers("2.02 (aim: 1.4) <!-- from hold: grip -->", known).endswith("grip = 2 1 -->")
    assert with_numbers("9 <!-- from hold: grip / measured = most -->", known).startswith("2.02")


@pytest.mark.parametrize("bounds", ["[51 to 92 %]", "[50 to 91 %]"])
def test_a_wrong_interval_is_found_and_written_again(bounds: str) -> None:
    page = "10 of 13 [50 to 92 %] are found. <!-- from slip: gross / quiet = 2 3 -->"
    assert not list(problems(page, KNOWN))
    wrong = page.replace("[50 to 92 %]", bounds)
    assert list(problems(wrong, KNOWN)) == ["1: the interval of 10 of 13 is [50 to 92 %]"]
    assert with_numbers(wrong, KNOWN) == page


def test_a_block_without_its_end_keeps_the_text_up_to_the_next() -> None:
    text = written().replace("<!-- end -->", "kept\n\n<!-- figure: slip -->\n<!-- end -->")
    assert "kept" in with_figures(text, KNOWN)
    assert any(problem.startswith("9: `<!-- figure: slip -->` has no") for problem in problems(text, KNOWN))


def test_an_old_figure_says_so_and_is_not_a_problem(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def git(*words: str) -> str:
        identity = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        command = ["git", "-C", str(tmp_path), *identity, *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    monkeypatch.setattr(tool, "ROOT", tmp_path)
    git("init", "-q")
    for name in ("measured", "other"):
        (tmp_path / name).touch()
        git("add", name)
        git("commit", "-qm", name)
    at = {"slip": replace(SLIP, commit=git("rev-parse", "HEAD~"), code=["measured"])}
    fresh = with_figures(PAGE, at)
    assert CHANGED not in fresh
    assert UNKNOWN not in fresh
    (tmp_path / "measured").write_text("a")
    git("commit", "-qam", "change")
    assert CHANGED in with_figures(PAGE, at)
    assert list(problems(fresh, at)) == []
    assert UNKNOWN in with_figures(PAGE, {"slip": replace(SLIP, commit="0" * 40)})


def test_numbers_of_a_text() -> None:
    found = numbers("1. 11,791 of seeds 0..9, p50 -0.01 (1.5), 2 [to](page-3.md) `4`")
    assert [value(one) for one in found] == [11791, 0, 9, -0.01, 1.5, 2]


def test_what_a_bench_writes_is_a_figure(tmp_path: Path) -> None:
    (tmp_path / "clock.json").write_text(
        as_json("./run bench clock", ["tactiled"], ["a", table([{"n": "1"}])])
    )
    figure = load_figures(tmp_path)["clock"]
    assert figure.sections == ["a", [{"n": "1"}]]
    assert "processors, load average" in figure.block([])


@pytest.mark.parametrize("content", ["{", "{}", json.dumps({"bench": "clock"})])
def test_a_file_that_is_no_figure_is_named(tmp_path: Path, content: str) -> None:
    (tmp_path / "clock.json").write_text(content)
    with pytest.raises(SystemExit, match=r"clock\.json: "):
        load_figures(tmp_path)


def test_paths_of_measured_code_exist() -> None:
    paths = [path for bench in BENCHES.values() for path in bench.code]
    paths += [path for figure in load_figures().values() for path in figure.code]
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_table_of_former_benches_is_a_figure(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text("# Page\n\n| bench | answer |\n|---|---|\n| `a` | 3 of 4 |\n")
    known = {"research": tool.research(tmp_path / "page.md")}
    page = "Of 4, 3. <!-- from research: `a` / answer = 2 1 -->"
    assert not list(problems(page, known))
    assert list(problems(page.replace("Of 4", "Of 5"), known)) == [
        "1: 5 is 4 in research/README.md at ``a` / answer`"
    ]
    assert tool.research().selected("Models of the emulator / answer")
    (tmp_path / "page.md").write_text("| bench | answer |\n|---|---|\n| `a` |\n")
    with pytest.raises(SystemExit, match="the row of `a` has 1 cells"):
        tool.research(tmp_path / "page.md")
