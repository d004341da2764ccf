"""A wrong file is answered with every fault at once, each a line with its place and a hint."""

from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, ValidationError

from tactiled import tomlfile
from tactiled.errors import ConfigError, OperatorError, UnavailableError
from tactiled.tomlfile import Params


class Disc(Params):
    """One variant of a union."""

    kind: Literal["disc"] = "disc"
    radius_mm: float = Field(gt=0)


class Plate(Params):
    """The other variant."""

    kind: Literal["plate"] = "plate"
    width_mm: float = Field(gt=0)


class Bench(Params):
    """A document with an optional table and an array of tables."""

    rate_hz: float = Field(gt=0)
    settle_s: float = 1.0
    count: int = 3
    label: str = ""
    main: Disc | None = None
    tools: list[Annotated[Disc | Plate, Field(discriminator="kind")]] = []


def faults(document: dict[str, object]) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        tomlfile.parse(document, Bench, "bench.toml")
    return caught.value.faults


def test_a_good_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text('rate_hz = 100\n[main]\nradius_mm = 2\n[[tools]]\nkind = "plate"\nwidth_mm = 1.5\n')
    bench = tomlfile.load(path, Bench)
    assert bench == Bench(rate_hz=100.0, main=Disc(radius_mm=2.0), tools=[Plate(width_mm=1.5)])


def test_parameters_cannot_be_changed_afterwards() -> None:
    bench = Bench(rate_hz=1.0)
    with pytest.raises(ValidationError, match="frozen"):
        bench.rate_hz = 2.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("document", "fault"),
    [
        ({}, "rate_hz: missing"),
        ({"rate_hz": -1}, "rate_hz: input should be greater than 0 (got -1)"),
        ({"rate_hz": "fast"}, "rate_hz: input should be a valid number"),
        ({"rate_hz": float("nan")}, "rate_hz: input should be a finite number (got nan)"),
        ({"rate_hz": float("inf")}, "rate_hz: input should be a finite number (got inf)"),
        ({"rate_hz": 1, "count": 2.5}, "count: input should be a valid integer"),
        (
            {"rate_hz": 1, "settle_ms": 5},
            "settle_ms: unknown key; units belong to the name here: use settle_s",
        ),
        ({"rate_hz": 1, "settle": 5}, "settle: unknown key; units belong to the name here: use settle_s"),
        ({"rate_hz": 1, "cuont": 5}, "cuont: unknown key; did you mean count?"),
        (
            {"rate_hz": 1, "zzz": 5},
            "zzz: unknown key; known here: rate_hz, settle_s, count, label, main, tools",
        ),
        (
            {"rate_hz": 1, "main": {"radius_cm": 1, "radius_mm": 1}},
            "main.radius_cm: unknown key; units belong to the name here: use radius_mm",
        ),
        ({"rate_hz": 1, "main": {"radius_mm": 0}}, "main.radius_mm: input should be greater than 0 (got 0)"),
        ({"rate_hz": 1, "main": 5}, "main: input should be"),
    ],
)
def test_each_fault_has_its_place_and_a_hint(document: dict[str, object], fault: str) -> None:
    (line,) = faults(document)
    assert line.startswith(fault)


def test_places_inside_lists_and_unions_are_named() -> None:
    (line,) = faults(
        {"rate_hz": 1, "tools": [{"kind": "disc", "radius_mm": 1}, {"kind": "plate", "width_mm": -1}]}
    )
    assert line == "tools[1].width_mm: input should be greater than 0 (got -1)"
    (line,) = faults({"rate_hz": 1, "tools": [{"kind": "plate", "width": 1, "width_mm": 1}]})
    assert line == "tools[0].width: unknown key; units belong to the name here: use width_mm"
    (line,) = faults({"rate_hz": 1, "tools": [{"kind": "ball"}]})
    assert line == "tools[0].kind: input should be one of disc, plate (got 'ball')"
    (line,) = faults({"rate_hz": 1, "tools": [{"radius_mm": 1}]})
    assert line == "tools[0].kind: missing"


def test_keys_of_the_chosen_variant_alone_are_listed() -> None:
    (line,) = faults({"rate_hz": 1, "tools": [{"kind": "disc", "radius_mm": 1, "disc": 1}]})
    assert line == "tools[0].disc: unknown key; known here: kind, radius_mm"


def test_one_fault_is_one_line_and_several_are_a_list() -> None:
    one = ConfigError("a.toml", ["x: missing"])
    assert str(one) == "a.toml: x: missing"
    several = ConfigError("a.toml", ["x: missing", "y: missing"])
    assert str(several) == "a.toml:\n  x: missing\n  y: missing"
    assert isinstance(one, OperatorError)
    assert (one.exit_code, UnavailableError("in use").exit_code) == (2, 1)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"rate_hz = ", "not valid TOML: "),
        (b"rate_hz = 1\nrate_hz = 2", "not valid TOML: "),
        (b"\xff\xfe", "is not UTF-8 text"),
    ],
)
def test_invalid_toml_is_reported(tmp_path: Path, content: bytes, fault: str) -> None:
    path = tmp_path / "bench.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        tomlfile.load(path, Bench)
    assert caught.value.source == str(path)
    assert caught.value.faults[0].startswith(fault)


def test_a_missing_file_names_its_neighbours(tmp_path: Path) -> None:
    (tmp_path / "left.toml").write_text("")
    (tmp_path / "right.toml").write_text("")
    with pytest.raises(ConfigError, match="no such file; beside it there are: left, right"):
        tomlfile.load(tmp_path / "lefft.toml", Bench)
    with pytest.raises(ConfigError, match=r"no such file$"):
        tomlfile.load(tmp_path / "nowhere" / "x.toml", Bench)


def test_what_a_file_says_is_shown_short_and_printable() -> None:
    long = faults({"rate_hz": "x" * 100_000, "\x1b[2J" + "y" * 100_000: 1, "z": 10**300})
    assert len(long) == 3
    assert all(len(fault) < 600 and fault.isprintable() for fault in long), long


def test_of_very_many_faults_some_are_listed() -> None:
    many = faults({"rate_hz": 1, **{f"k{k}": 1 for k in range(10_000)}})
    assert len(many) == 51
    assert many[-1] == "and 9950 more"
