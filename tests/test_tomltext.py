"""TOML of others: what would exhaust the parser is refused with its place."""

import os
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactiled import resources, tomltext
from tactiled.errors import ConfigError


def fault_of(folder: Path, text: str) -> str:
    path = folder / "t.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        tomltext.read(path)
    assert caught.value.exit_code == 2
    (fault,) = caught.value.faults
    return fault


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (
            "[port]\nurl = " + "[" * 5000 + "]" * 5000,
            "port.url (line 2): more than 32 brackets in one another",
        ),
        ("[port]\nurl = " + "{a=" * 5000, "port.url (line 2): more than 32 brackets in one another"),
        ("a = [\n" * 5000, "a (line 33): more than 32 brackets in one another"),
        (
            "[a]\nx = '''\n[b]'''\nbaud = " + "9" * 5000,
            "a.baud (line 4): a word or number of 5000 characters",
        ),
        ("baud = 0x" + "f" * 5000, "baud (line 1): a word or number of 5002 characters"),
        ("a." * 100_000 + "b = 1", "text (line 1): a word or number of 200001 characters"),
        ('[board]\narray = "a\\u0000b"', "board.array: has the character NUL"),
        ('a = [1, {b = "\\u0000"}]', "a.1.b: has the character NUL"),
        ('"\\u0000" = 1', "\\x00: has the character NUL"),
        ("[x]\n" + '"a" . ' * 100_000 + "b = 1", "x (line 2): a key of more than 32 parts"),
    ],
)
def test_what_exhausts_the_parser_is_named_with_its_place(tmp_path: Path, text: str, fault: str) -> None:
    assert fault_of(tmp_path, text).startswith(fault)


@pytest.mark.parametrize(
    "text", ['a = "\\', '"\\' * 100_000, '"\n' * 100_000, "'''" * 99_999, '"""\\' * 100_000]
)
def test_strings_without_end_are_left_to_the_parser(tmp_path: Path, text: str) -> None:
    assert "line" in fault_of(tmp_path, text) or "end of document" in fault_of(tmp_path, text)


def test_long_strings_and_comments_are_no_excess(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    text = '# {n}\na = "{n}" # {n}\nb = \'{n}\'\nc = """\n{n} \\""" {n}"""\n'.replace(
        "{n}", "[" * 500 + "9." * 500
    )
    path.write_text(text)
    assert tomltext.read(path) == tomllib.loads(text)


def test_every_shipped_file_is_read_as_the_parser_reads_it() -> None:
    files = [path for kind in ("config", "protocols") for path in resources.shipped(kind).rglob("*.toml")]
    assert len(files) > 10
    for path in files:
        assert tomltext.read(path) == tomllib.loads(path.read_text())


@given(st.text(st.sampled_from("[]{}\"'#=.,ab9 \\\n"), max_size=60))
def test_short_texts_are_judged_by_the_parser_alone(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "t.toml"
    path.write_text(text)
    try:
        expected = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        if text.count("[") + text.count("{") <= 32:
            assert fault_of(path.parent, text).startswith("not valid TOML")
    else:
        assert tomltext.read(path) == expected


@given(st.text())
def test_every_text_is_quoted_so_that_the_parser_reads_it_back(text: str) -> None:
    assert tomllib.loads(f"a = {tomltext.quoted(text)}")["a"] == text


@pytest.mark.parametrize("kind", ["fifo", "device", "folder"])
def test_what_is_no_regular_file_is_refused_and_not_read(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "t.toml"
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with pytest.raises(ConfigError, match=r"t\.toml: is not a regular file"):
        tomltext.read(path)


def test_a_byte_order_mark_is_no_fault(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert tomltext.read(path) == {"a": 1}
