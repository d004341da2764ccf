"""The published methods as a setting of the detectors, found by its entry point."""

from pathlib import Path

import pytest
from commands import call
from touches import Touch, onsets

from tactiled.array import load_array
from tactiled.detect import suite
from tactiled.detect.signal.slip_gate import KnownSliding
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.errors import ConfigError
from tactiled.log_summary import LogTally
from tactiled.offline import Choices
from tactiled.tomlfile import parse


def test_the_setting_runs_the_published_rule() -> None:
    array = load_array("wang2019-3x3")
    found = build_suite(array, DetectParams(setting="wang2019"), topics=("slip",))
    (onset,) = onsets(found.process(Touch().block(array)))
    assert onset.detector == "wang2019"


def test_without_the_distribution_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite, "_packaged", dict)
    with pytest.raises(
        ConfigError, match=r"setting: needs tactiled-wang2019.*\./packages/wang2019 in a checkout"
    ):
        parse({"setting": "wang2019"}, DetectParams, "test")
    with pytest.raises(ConfigError, match="setting: input should be one of fast, balanced, quiet, wang2019"):
        parse({"setting": "none"}, DetectParams, "test")


def test_keys_that_the_published_methods_do_not_read_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tables = "[detect.texture]\nmin_period_mm = 0.7\nhop_s = 1.0\n[detect.grip]\nincipient_p = 0.8\n"
    config = tmp_path / "left.toml"
    for setting in ("wang2019", "balanced"):
        config.write_text(f'[port]\nurl = "loop://"\n[detect]\nsetting = "{setting}"\n{tables}')
        assert call("check-config", str(config)) == 0
        warnings = [line for line in capsys.readouterr().err.splitlines() if "not read" in line]
        assert warnings == [
            f"warning: detect.{key}: not read by setting wang2019"
            for key in ("texture.min_period_mm", "texture.hop_s", "grip.incipient_p")
            if setting == "wang2019"
        ]
    assert Choices(setting="wang2019", direction_deg=30.0).params().unread() == []
    array = load_array("wang2019-3x3")
    log = LogTally(array, "log")
    block = Touch().block(array)
    log.add_scans(block.time_s, block.volts)
    told = list(Choices(setting="wang2019", period_mm=(1.0, 2.0)).summary(log))
    words = "detect.texture.min_period_mm, detect.texture.max_period_mm"
    assert told[-1] == f"not read by setting wang2019: {words}"


def test_an_array_in_another_unit_than_volts_is_refused() -> None:
    """0.5 and 0.002 are volts: of newtons they would be other loads and other kinks."""
    newtons, known = load_array("xyz-two-pads-4x4"), KnownSliding(0.0, 1.0)
    params = DetectParams(setting="wang2019")
    with pytest.raises(ConfigError, match=r"wang2019 has thresholds in V: .* xyz-two-pads-4x4 are in N"):
        Choices(setting="wang2019").suite(newtons, params)
    Choices(setting="wang2019", sliding=known, topics=("texture",)).suite(newtons, params)


def test_an_array_without_shear_is_refused(tmp_path: Path) -> None:
    plain, known = load_array("normal-3x3"), KnownSliding(0.0, 1.0)
    params = DetectParams(setting="wang2019")
    with pytest.raises(ConfigError, match="wang2019 needs channels of shear and load: normal-3x3 lacks them"):
        Choices(setting="wang2019").suite(plain, params)
    Choices(setting="wang2019", sliding=known, topics=("texture",)).suite(plain, params)
    config = tmp_path / "left.toml"
    board = '[board]\nprotocol = "legacy-9"\narray = "normal-3x3"\n'
    config.write_text(f'[port]\nurl = "loop://"\n[detect]\nsetting = "wang2019"\n{board}')
    assert call("check-config", str(config)) == 2
