"""What doctor and check-config say of grooves: angle, equal gaps, speeds."""

from pathlib import Path

import numpy as np
import pytest

from tactiled.array import load_array
from tactiled.cli import main
from tactiled.config import load_config
from tactiled.detect.grooves.params import JointParams
from tactiled.doctor.abilities import check_waves
from tactiled.doctor.unplugged import resolved_in_words

WANG = load_array("wang2019-3x3")
EQUAL = load_array("normal-3x3")
ALONG_X = JointParams(direction_deg=0.0)


def test_findings_name_periods_speeds_and_options() -> None:
    grooves, speeds = check_waves(WANG, JointParams(), 100.0, 1.5)
    assert grooves.verdict == speeds.verdict == "ok"
    assert "period and angle, of 0.5 to 20 mm" in grooves.words
    assert "2 mm/s or faster to measure periods of 20 mm" in speeds.words
    assert "rad" not in grooves.words + speeds.words
    grooves, fast = check_waves(WANG, JointParams(), 100.0, 60.0)
    assert fast.verdict == "warn"
    assert "at 60 mm/s, periods below 1.33 mm are too fine" in fast.words
    assert fast.remedy.startswith("slide at 22.5 mm/s or slower to measure periods of 0.5 mm")
    poor, _ = check_waves(EQUAL, ALONG_X, 100.0, 0.0)
    assert poor.verdict == "warn"
    assert "gaps between taxels are equal" in poor.words
    assert "set detect.texture.min_period_mm above 10 if" in poor.remedy
    assert "unequal gaps" in poor.remedy


@pytest.mark.parametrize(("min_period_mm", "verdict"), [(9.9, "warn"), (10.0, "warn"), (10.1, "ok")])
def test_equal_gaps_are_ambiguous_up_to_a_period_of_twice_the_gap(min_period_mm: float, verdict: str) -> None:
    grooves, _ = check_waves(EQUAL, JointParams(min_period_mm=min_period_mm), 100.0, 1.5)
    assert (grooves.verdict, "gaps between taxels are equal" in grooves.words) == (verdict, verdict == "warn")


def test_one_taxel_resolves_no_angle() -> None:
    x_mm, y_mm = np.zeros_like(WANG.x_mm), np.zeros_like(WANG.y_mm)
    one = WANG.__class__(**{**vars(WANG), "x_mm": x_mm, "y_mm": y_mm})
    none, _ = check_waves(one, JointParams(), 100.0, 60.0)
    assert none.verdict == "warn"
    assert none.words.startswith(
        "the angle is not measured (status period-only); the period along the motion is 60 mm/s divided"
    )


def test_check_config_uses_the_configured_speed_or_any(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "t.toml"
    path.write_text('[port]\nurl = "/dev/none"\n[detect.texture]\nspeed_mm_s = 1.5\n')
    monkeypatch.setattr("sys.argv", ["tactiled", "check-config", str(path)])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code
    valid, port, _, _, grooves, speeds, path_of_scans = capsys.readouterr().err.splitlines()
    assert ("valid" in valid, port) == (True, "port: /dev/none")
    assert grooves == "grooves: period and angle, of 0.5 to 20 mm"
    assert speeds.startswith("sliding speed: ")
    assert path_of_scans.startswith("path of a scan: ")
    path.write_text('[port]\nurl = "/dev/none"\n')
    _, speeds = resolved_in_words(load_config(path))
    assert speeds.startswith("sliding speed: slide at 22.5 mm/s or slower")
