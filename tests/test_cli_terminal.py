"""What the verbs print in a terminal of 80 columns: lines for people, and JSON where it is asked for."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from terminals import COLUMNS, in_terminal

from tactiled.cli.entry import cli
from tactiled.resources import shipped

ARRAY = str(shipped("config", "arrays") / "normal-4x4.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of an emulated rig, whose array is pressed and pushed, and a log of a hold."""
    made = tmp_path_factory.mktemp("terminal")
    rig = ["emulate", "--rig", str(made / "rig"), "--seed", "3", "--rig-s", "15"]
    assert CliRunner().invoke(cli, rig).exit_code == 0
    time_s = np.arange(0, 12, 0.01)
    noise = 0.001 * np.random.default_rng(1).standard_normal((len(time_s), 36))
    np.savez(
        made / "hold.npz", time_s=time_s, volts=np.interp(time_s, [1, 1.5], [0, 1])[:, np.newaxis] + noise
    )
    return made


def test_detect_prints_one_short_line_for_an_event(folder: Path) -> None:
    code, shown = in_terminal("detect", "rig/log.npz", cwd=folder)
    assert code == 0
    events = [line for line in shown if re.match(r" +\d+\.\d{3} s  ", line)]
    assert any(line.endswith("contact none -> loading") for line in events)
    assert events == sorted(events, key=lambda line: float(line.split()[0]))
    assert max(map(len, shown)) <= COLUMNS
    assert not any("{" in line for line in shown)
    assert "of them shown; all with --json" in shown[-1]


def test_json_is_printed_in_a_terminal_where_it_is_asked_for(folder: Path) -> None:
    detect = ("detect", "rig/log.npz", "--only", "contact")
    code, shown = in_terminal(*detect, "--json", cwd=folder)
    text = "".join(line for line in shown if not line.startswith(("detect ", "rig/log.npz:")))
    piped = CliRunner().invoke(cli, ["detect", str(folder / "rig/log.npz"), *detect[2:]])
    assert (code, text.replace("}{", "}\n{").splitlines()) == (0, piped.stdout.splitlines())
    assert {json.loads(line)["topic"] for line in piped.stdout.splitlines()} == {"contact"}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("calibrate", "rig/log.npz", "--reference", "rig/reference.csv", "-o", "mine.toml"),
         ["mine.toml: force calibration of wang2019-3x3", "normal force to", "rms error in segments"]),
        (("tune", "--quiet", "hold.npz", "--motion", "hold.npz"),
         ["proposed for 60 reports per hour", 'setting = "']),
        (("check-config", ARRAY), ["valid (array normal-4x4: 16", "contact: from the pressure of 16"]),
        (("check-config", str(shipped("config") / "tactiled.toml")),
         ["valid (wang2019-3x3,", "events: setting balanced, at tcp://127.0.0.1:9872", "recordings: none"]),
        (("check-config", str(shipped("protocols") / "board-v1.toml")), ["valid (layout tactiled-board: 36"]),
        (("check-config", str(shipped("config", "calibration") / "wang2019-3x3.toml")),
         ["nominal: from published sensitivities"]),
    ],
)  # fmt: skip
def test_a_verdict_is_short_and_in_words(folder: Path, arguments: tuple[str, ...], says: list[str]) -> None:
    code, shown = in_terminal(*arguments, cwd=folder)
    assert code == 0, shown
    for words in says:
        assert words in "\n".join(shown)
    assert len(shown) <= 30
    assert max(map(len, shown)) <= COLUMNS or "/" in max(shown, key=len)  # a path is not broken
    assert "{" not in "".join(shown).replace("{runtime}", "")


@pytest.mark.parametrize(
    "arguments",
    [
        ("detect", "none.csv"), ("detect", "rig/reference.csv"), ("check-config", "none.toml"),
        ("calibrate", "rig/log.npz", "--reference", "rig/log.npz", "-o", "mine.toml"),
        ("tune", "--quiet", "hold.npz", "--motion", "rig/reference.csv"), ("listen", "nonsense"),
    ],
)  # fmt: skip
def test_bad_input_is_a_short_message(folder: Path, arguments: tuple[str, ...]) -> None:
    code, shown = in_terminal(*arguments, cwd=folder)
    assert code == 2
    assert any(line.startswith("tactiled: ") for line in shown)
    assert max(map(len, shown)) <= COLUMNS
    assert not any("Traceback" in line for line in shown)
