"""What check-config says that an array can measure: contact, slip, direction, grooves."""

from pathlib import Path

import pytest
from commands import call

from tactiled.array import load_array
from tactiled.detect.grooves.params import JointParams
from tactiled.doctor.abilities import abilities
from tactiled.doctor.finding import Finding

SHEAR_ONLY = """
name = "field"
unit = "uT"
range = [-100, 100]
taxel_count = 2
[[taxel_channels]]
name = "X"
kind = "shear_x"
"""


def found(array: str, speed_mm_s: float = 0.0) -> dict[str, Finding]:
    """Findings on an array at 100 Hz, by their checks."""
    return {one.check: one for one in abilities(load_array(array), JointParams(), 100.0, speed_mm_s)}


@pytest.mark.parametrize(
    ("name", "slip", "direction", "grooves"),
    [
        ("wang2019-3x3", "found from shear and pressure", "that of a slip", "and angle, of 0.5 to 20 mm"),
        (
            "normal-4x4",
            "found where load moves between taxels",
            "not measured",
            "gaps between taxels are equal",
        ),
        (
            "load-cell",
            "not reported: no shear channels, and fewer",
            "not measured",
            "the angle is not measured (status period-only); the frequency",
        ),
        ("magnetometers-5", "found where field grows", "but no load", "the angle is not measured"),
    ],
)
def test_abilities_follow_from_the_channels_and_places(
    name: str, slip: str, direction: str, grooves: str
) -> None:
    words = {check: finding.words for check, finding in found(name).items()}
    assert list(words) == ["contact", "slip", "direction", "grooves", "sliding speed"]
    assert slip in words["slip"]
    assert direction in words["direction"]
    assert grooves in words["grooves"]


def test_without_pressure_there_is_no_contact_and_slip_has_no_direction(tmp_path: Path) -> None:
    file = tmp_path / "field.toml"
    file.write_text(SHEAR_ONLY)
    of = found(str(file), 5.0)
    assert [of[check].verdict for check in ("contact", "slip", "direction")] == ["warn"] * 3
    assert "5 mm/s divided by the frequency" in of["grooves"].words


@pytest.mark.parametrize(
    ("kind", "says"),
    [('kind = "side"\nazimuth_deg = {}', "found from shear"), ('kind = "shear_x"', "where field grows")],
)
def test_sides_in_microtesla_are_pressures_and_axes_are_fields(kind: str, says: str, tmp_path: Path) -> None:
    channels = [f'[[taxel_channels]]\nname = "C{k}"\n{kind.format(90 * k)}' for k in range(4)]
    head = 'name = "skin"\nunit = "uT"\nrange = [-100, 100]\ntaxel_count = 2'
    file = tmp_path / "skin.toml"
    file.write_text("\n".join([head, *channels]))
    assert says in found(str(file))["slip"].words


def test_check_config_says_and_draws_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, picture = tmp_path / "field.toml", tmp_path / "field.svg"
    file.write_text(SHEAR_ONLY)
    assert call("check-config", str(file), "--plot", str(picture), "--rate", "50") == 0
    captured = capsys.readouterr()
    assert captured.out.count("\n") == 1
    assert "contact: not measured" in captured.err
    assert "11.2 mm/s or slower to measure periods of 0.5 mm" in captured.err
    assert picture.read_text().count("<svg") == 1


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        (["protocols/tsf-85.toml", "--plot", "a.png"], "--plot draws an array"),
        (["config/arrays/load-cell.toml", "--plot", "a.bmp"], "--plot: a.bmp: name a .png"),
        (["config/arrays/load-cell.toml", "--plot", "/none/a.png"], "in a folder that exists"),
    ],
)
def test_what_cannot_be_drawn_is_a_usage_error(
    options: list[str], fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    root = Path(__file__).parents[2]
    assert call("check-config", str(root / options[0]), *options[1:]) == 2
    assert fault in capsys.readouterr().err


def test_a_picture_on_a_full_disk_is_an_error_of_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "full.svg"
    picture.symlink_to("/dev/full")
    array = Path(__file__).parents[2] / "config/arrays/load-cell.toml"
    assert call("check-config", str(array), "--plot", str(picture)) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert f"{picture}: the picture cannot be written: No space left" in last
