"""Checks of what comes from outside: sizes, kinds of files, JSON, names."""

import os
from pathlib import Path

import pytest

from tactiled.errors import DataError
from tactiled.outside import json_of, name_of, need_regular, read_text, rule_value, shown


def test_a_text_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / "t"
    path.write_text("12345")
    assert read_text(path, 5) == "12345"
    with pytest.raises(DataError, match="has more than 4 bytes"):
        read_text(path, 4)
    path.write_bytes(b"a\xff")
    with pytest.raises(DataError, match=r"is not UTF-8 text .* at byte 1"):
        read_text(path)


def test_only_regular_files_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path, tmp_path / "fifo", Path("/dev/zero")):
        with pytest.raises(DataError, match="is not a regular file"):
            need_regular(path)
    with pytest.raises(FileNotFoundError):
        need_regular(tmp_path / "none")


@pytest.mark.parametrize("text", ["", "[" * 100_000, '{"a":' * 100_000, "9" * 5000, "nul", '"\\u12"'])
def test_json_that_no_program_reads_is_refused(text: str) -> None:
    with pytest.raises(DataError, match=r"is no JSON|is nested too deeply"):
        json_of(text)


def test_json_is_read() -> None:
    assert json_of('{"a": [1, null]}') == {"a": [1, None]}


@pytest.mark.parametrize("text", ["a", "left-hand", "A_5.x", "9", "a" * 64])
def test_names(text: str) -> None:
    assert name_of(text) == text


@pytest.mark.parametrize("text", ["", ".", "..", "-a", "_a", "a/b", "a b", "a\n", "é", "a" * 65])
def test_what_is_no_name_is_refused(text: str) -> None:
    with pytest.raises(DataError, match="is no name"):
        name_of(text)


@pytest.mark.parametrize(
    ("text", "value"), [("A5", "A5"), (" a  b ", "a_b"), ("0:1.2-x_", "0:1.2-x_"), ("a" * 126, "a" * 126)]
)
def test_values_of_rules(text: str, value: str) -> None:
    assert rule_value(text) == value


@pytest.mark.parametrize("text", ["", " ", '"', "*", "a\tb", "a\n", "$x", "%k", "a,b", "é", "a" * 127])
def test_what_may_not_stand_in_a_rule_is_refused(text: str) -> None:
    with pytest.raises(DataError, match="may not stand in a udev rule"):
        rule_value(text)


def test_a_text_is_shown_short_and_printable() -> None:
    assert shown("a\x1b[2J") == r"'a\x1b[2J'"
    assert shown("x" * 100) == f"'{'x' * 60}'..."
