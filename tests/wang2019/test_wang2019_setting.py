"""The published methods as a setting of the detectors, found by its entry point."""

import pytest
from touches import Touch, onsets

from tactiled.array import load_array
from tactiled.detect import suite
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.errors import ConfigError
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
