"""Layout files: the shipped ones say what board.md says; a broken one is refused by the place."""

import copy
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tactiled import resources, tomlfile
from tactiled.errors import ConfigError
from tactiled.wire.layout import load_layout
from tactiled.wire.schema import LayoutFile

Document = dict[str, Any]


def shipped(name: str) -> Document:
    return tomllib.loads(resources.shipped("protocols", f"{name}.toml").read_text())


def put(*path: str | int, value: Any) -> Callable[[Document], None]:
    """Set one value deep inside the document."""

    def mutate(document: Any) -> None:
        for key in path[:-1]:
            document = document[key]
        document[path[-1]] = value

    return mutate


def drop(*path: str | int) -> Callable[[Document], None]:
    def mutate(document: Any) -> None:
        for key in path[:-1]:
            document = document[key]
        del document[path[-1]]

    return mutate


def add_field(message: int, **field: Any) -> Callable[[Document], None]:
    return lambda document: document["messages"][message]["fields"].append(field)


def twice(index: int) -> Callable[[Document], None]:
    return lambda document: document["messages"].append(copy.deepcopy(document["messages"][index]))


V1, L9, TSF, M5 = "board-v1", "legacy-9", "tsf-85", "magnetometers-5"
SCAN, HELLO = ("messages", 0, "fields"), ("messages", 1, "fields")
BROKEN: list[tuple[str, Callable[[Document], None], str]] = [
    (V1, drop("byte_order"), "byte_order: missing"),
    (V1, put("bauds", value=1), "bauds: unknown key; did you mean baud?"),
    (V1, drop("framing"), "framing: missing"),
    (V1, put("messages", value=[]), "messages: "),
    (V1, drop("messages", 0), "there is no scan"),
    (V1, drop("messages", 1), "give either a hello message or [assumed_hello]"),
    (V1, drop("messages", 2), "commands need an acknowledge"),
    (V1, twice(0), "messages: scan is described twice"),
    (V1, put("messages", 1, "id", value=1), "messages: id 1 is used twice board-to-host"),
    (V1, put("messages", 0, "id", value=256), "messages[0].id: input should be less than or equal to 255"),
    (V1, drop(*SCAN, 0), "scan: lacks the field sequence"),
    (V1, drop(*SCAN, 3), "messages[0]: scan: lacks the field counts"),
    (V1, drop("messages", 5, "fields", 1), "messages[5]: set_rate: lacks the field rate_hz"),
    (V1, add_field(0, name="flags", type="u8"), "messages[0]: scan: field flags is listed twice"),
    (V1, add_field(0, name="gain", type="u8"), "messages[0]: scan: no such field as gain; known: counts"),
    (V1, put(*SCAN, 0, "type", value="f32"), "messages[0].fields[0]: sequence must be u8 or u16 or u32"),
    (V1, put(*SCAN, 0, "type", value="i16"), "messages[0].fields[0]: sequence must be u8 or u16 or u32"),
    (V1, put(*SCAN, 3, "type", value="f32"), "counts must be an integer: f32"),
    (V1, put(*SCAN, 0, "type", value="text"), "messages[0].fields[0]: sequence must be u8"),
    (V1, put(*SCAN, 0, "size", value=2), "messages[0].fields[0]: size belongs to type"),
    (V1, put(*SCAN, 0, "per_unit", value=10), "per_unit has no meaning for sequence"),
    (V1, drop(*HELLO, 1, "size"), "messages[1].fields[1]: size belongs to type = 'text'"),
    (V1, put(*HELLO, 6, "per_unit", value=1000), "ticks must have the same type and per_unit"),
    (V1, put("results", value={}), "results: 'ok' is missing"),
    (V1, put("results", "busy", value=256), "results.busy: 256 does not fit"),
    (V1, put("results", "busy", value=0), "results.busy: 0 is used twice"),
    (V1, put("flags", "overrun", value=16), "flags.overrun: the scan's flags have no bit 16"),
    (V1, put("flags", "overflow", value=5), "flags.overflow: no such flag; known: first_after_start"),
    (L9, drop("assumed_hello", "rate_hz"), "assumed_hello.rate_hz: missing"),
    (L9, drop("assumed_hello", "adc_bits"), "assumed_hello.adc_bits: missing"),
    (TSF, drop("assumed_hello", "adc_bits"), "assumed_hello.adc_bits: missing"),
    ("lines-15", put("messages", 0, "fields", 0, "type", value="f32"), "counts"),
    ("lines-15", put("messages", 0, "id", value=1), "messages: framing.kind = 'lines' carries no id"),
    (M5, put("messages", 0, "id", value=1), "messages: framing.kind = 'terminator' carries no id"),
    (TSF, put("messages", 0, "id", value=1), "messages: framing.kind = 'tagged' carries no id"),
    (L9, drop("assumed_hello"), "give either a hello message or [assumed_hello]"),
    (L9, drop("assumed_hello", "array_id"), "assumed_hello.array_id: missing"),
    (L9, put("assumed_hello", "board_serial", value="\x1b[2J"), "board_serial: has characters that are not"),
    (L9, put("assumed_hello", "array_id", value="a\n"), "array_id: has characters that are not printable"),
    (L9, put("assumed_hello", "channel_offset_s", value=[0.1]), "assumed_hello.channel_offset_s: 1 numbers"),
    (L9, put("flags", value={"overrun": 0}), "flags.overrun: the scan's flags have no bit 0"),
    (V1, put("framing", "sync_hex", value="A55A"), "framing.sync_hex: unknown key"),
    (V1, put("framing", "kind", value="hdlc"), "framing.kind: input should be one of cobs, terminator, "),
    (V1, drop("framing", "kind"), "framing.kind: missing"),
    (TSF, drop("framing", "records"), "framing.records: missing"),
    (TSF, drop("framing", "sync_hex"), "framing.sync_hex: missing"),
    (TSF, put("framing", "sync_hex", value="9 A"), "framing.sync_hex: "),
    (M5, drop("framing", "terminator_hex"), "framing.terminator_hex: missing"),
    (TSF, put("channels", value=28), "framing.records: those with channels = true have 112 bytes"),
    (TSF, drop("framing", "records", 1), "framing.records: those with channels = true have 56 bytes"),
    (TSF, put("framing", "records", 1, "tag", value=0x10), "records[1].tag: 0x10 is used twice"),
    (TSF, put("framing", "records", 1, "tag", value=0x15), "records[1].tag: 0x15 has bits outside tag_mask"),
    (TSF, put("framing", "records", 1, "bytes", value=60), "records[1].bytes: 60 and the tag exceed"),
    (TSF, put("framing", "records", 1, "bytes", value=55), "records[1].bytes: 55 is no whole number of u16"),
    (TSF, put("framing", "records", 1, "channel", value=True), "records[1].channel: unknown key; did you"),
    (TSF, put("framing", "most_bytes", value=256), "framing.most_bytes: input should be less than or"),
    (TSF, put("messages", 1, "name", value="ping"), "messages[1]: ping cannot be fixed bytes"),
    (TSF, drop("messages", 1, "hex"), "messages[1]: start: give either fields or, for start and stop, hex"),
    (TSF, drop("messages", 1), "messages: stop has hex, so start needs hex, too"),
    (TSF, put("messages", 2, "hex", value="9A005801"), "messages: the hex of start and stop must differ"),
    (TSF, put("messages", 0, "hex", value="00"), "messages[0]: scan: give either fields or"),
    (V1, put("messages", 3, value={"name": "start", "hex": "01"}),
     "messages: hex belongs to framing.kind"),
    (M5, put("messages", 0, "fields", 0, "left_out", value=[0, 0]), "left_out: positions must differ"),
    (M5, put("messages", 0, "fields", 0, "left_out", value=[20]), "left_out: positions must differ and lie"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "mutate", "fault"), BROKEN, ids=[fault[:60] for _, _, fault in BROKEN])
def test_a_broken_layout_is_refused_by_its_place(
    name: str, mutate: Callable[[Document], None], fault: str
) -> None:
    document = shipped(name)
    mutate(document)
    with pytest.raises(ConfigError) as caught:
        tomlfile.parse(document, LayoutFile, "lab.toml")
    assert str(caught.value).startswith("lab.toml: ")
    assert any(line.startswith(fault) or fault in line for line in caught.value.faults)
    assert "\n" not in "".join(caught.value.faults)


def test_faults_of_one_file_are_told_together() -> None:
    document = shipped("board-v1")
    document["baud"] = 0
    del document["messages"][0]["fields"][3]
    document["messages"][1]["id"] = 256
    with pytest.raises(ConfigError) as caught:
        tomlfile.parse(document, LayoutFile, "lab.toml")
    assert len(caught.value.faults) == 3


def test_shipped_sizes_are_those_of_the_prose() -> None:
    board, legacy = load_layout("board-v1"), load_layout("legacy-9")
    # COBS code, type, fields, CRC-16, delimiter
    sizes = {name: message.dtype.itemsize + 5 for name, message in board.messages.items()}
    assert (sizes["scan"], sizes["hello"], sizes["acknowledge"]) == (85, 144, 13)
    assert (sizes["start"], sizes["set_rate"]) == (7, 11)
    assert board.tick_s == 1e-6
    assert (board.bits("scan", "sequence"), board.bits("scan", "ticks")) == (16, 32)
    assert (board.flag("first_after_start"), board.flag("overrun"), board.flag("reference_fault")) == (
        1,
        2,
        4,
    )
    assert legacy.messages["scan"].dtype.itemsize + 5 == legacy.wire_bytes("scan") == 26
    assert legacy.tick_s == 1e-3
    assert legacy.flag("overrun") == 0
    assert legacy.bits("scan", "flags") is None


def test_a_name_that_is_not_shipped_lists_those_that_are() -> None:
    with pytest.raises(
        ConfigError, match=r"no layout named 'board-v9'; shipped: board-v1, legacy-9, lines-15, load-cell"
    ):
        load_layout("board-v9")


def test_a_layout_is_loaded_from_a_path(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        resources.shipped("protocols", "legacy-9.toml").read_text().replace('"legacy-9"', '"lab"')
    )
    assert load_layout(str(path)).name == "lab"
    with pytest.raises(ConfigError, match="no such file; beside it there are: lab"):
        load_layout(str(tmp_path / "lap.toml"))


def test_an_assumed_hello_is_what_the_file_says() -> None:
    for measured_hz in (None, 33.0):  # the file states the rate
        hello = load_layout("legacy-9").assumed_hello(measured_hz)
        assert hello is not None
        assert (hello.board_serial, hello.array_id, hello.rate_hz) == ("legacy", "normal-3x3", 50.0)
        assert (hello.adc_bits, hello.adc_reference_v, hello.protocol_version) == (10, 5.0, 1)
    assert load_layout("lines-15").assumed_hello() is None
    measured = load_layout("lines-15").assumed_hello(33.0)
    assert measured is not None
    assert measured.rate_hz == 33.0


def test_positions_that_are_no_channels_are_left_out() -> None:
    places = load_layout("magnetometers-5").channel_places
    assert places is not None
    assert places.tolist() == [k for k in range(20) if k % 4]
    assert load_layout("board-v1").channel_places is None


@pytest.mark.parametrize(
    ("name", "mutate"),
    [
        (L9, put("assumed_hello", "channel_offset_s", value=[0.0] * 9)),
        (L9, put("messages", 0, "id", value=255)),
    ],
)
def test_what_just_fits_is_accepted(name: str, mutate: Callable[[Document], None]) -> None:
    document = shipped(name)
    mutate(document)
    tomlfile.parse(document, LayoutFile, "lab.toml")
