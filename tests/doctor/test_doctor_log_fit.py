"""What an array file should say, by a log of it."""

from pathlib import Path

import numpy as np
import pytest
from commands import call

from tactiled.array import Array, ArrayFile, build
from tactiled.doctor.finding import Finding
from tactiled.doctor.log_fit import log_fit
from tactiled.errors import DataError
from tactiled.tomlfile import parse

PAD = {
    "name": "pad",
    "unit": "uT",
    "range": [-2000, 2000],
    "zero": "first 0.3 s",
    "taxel_count": 3,
    "taxel_channels": [{"name": "X", "kind": "shear_x"}, {"name": "Z", "kind": "normal"}],
}


def array(**changes: object) -> Array:
    return build(parse({**PAD, **changes}, ArrayFile, "test"))


def press(signs: tuple[float, ...] = (1, 1, 1), rest: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Ten seconds at 50 Hz: a press from 4 to 6 s, of the sign of each taxel."""
    rng = np.random.default_rng(0)
    time_s = 7.0 + np.arange(500) / 50.0
    load = 800.0 * ((time_s > 11) & (time_s < 13))[:, np.newaxis] * np.repeat(signs, 2)
    return time_s, rest + load * np.tile([0.2, 1.0], 3) + rng.standard_normal((500, 6))


def findings(of: Array, time_s: np.ndarray, readings: np.ndarray) -> dict[str, Finding]:
    return {each.check.removeprefix("log: "): each for each in log_fit(of, time_s, readings)}


def test_an_array_that_fits_is_told_so() -> None:
    found = findings(array(), *press())
    assert {each.verdict for each in found.values()} == {"ok"}
    assert found["rate"].values["rate_hz"] == pytest.approx(50.0)


def test_channels_that_fall_under_load_are_named() -> None:
    one = findings(array(), *press(signs=(1, -1, 1)))["signs"]
    assert one.verdict == "warn"
    assert "[[channels]]" in one.remedy
    assert one.words.endswith(": t1.Z")
    every = findings(array(), *press(signs=(-1, -1, -1)))["signs"]
    assert "sign = -1" in every.remedy
    channels = [{"name": "X", "kind": "shear_x"}, {"name": "Z", "kind": "normal", "sign": -1}]
    turned = findings(array(taxel_channels=channels), *press(signs=(-1, -1, -1)))["signs"]
    assert turned.verdict == "ok"
    # A log that begins under load falls, too, whatever the sign is.
    lifted = findings(array(taxel_channels=channels), *press(signs=(1, 1, 1)))["signs"]
    assert lifted.remedy.startswith(
        "if that is a press, sign = 1 for that kind; if the log begins under load"
    )


def test_range_zero_and_dead_channels_are_compared() -> None:
    time_s, readings = press(rest=1500.0)
    readings[:, 0] = 1500.0
    found = findings(array(zero=0), time_s, readings)
    assert found["range"].verdict == "fail"
    assert found["range"].remedy.startswith("range = [-2000, 230")
    assert found["channels"].words == "never change: t0.X"
    assert found["zero"].words.endswith(": t0.X, t0.Z, t1.X, t1.Z, t2.X, t2.Z")
    clipped = findings(array(), time_s, np.minimum(readings, 2000.0))["range"]
    assert (clipped.verdict, "saturated" in clipped.words) == ("warn", True)


def test_channels_that_come_up_after_the_zero_are_named() -> None:
    time_s, readings = press()
    readings[:10, 3] = np.nan
    assert findings(array(), time_s, readings)["zero"].verdict == "ok"
    readings[:20, 3] = np.nan
    zero = findings(array(), time_s, readings)["zero"]
    assert zero.verdict == "warn"
    assert zero.words.endswith(": t1.Z")


def test_uneven_steps_and_pauses_are_told() -> None:
    rng = np.random.default_rng(1)
    steps_s = rng.permutation(np.repeat([0.073, 0.136], 250))
    steps_s[100] = 5.0
    rate = findings(array(), np.cumsum(steps_s), press()[1])["rate"]
    assert "uneven" in rate.words
    assert "1 pauses" in rate.words


def test_a_log_at_rest_or_without_readings_tells_no_sign() -> None:
    time_s, readings = press(signs=(0, 0, 0))
    at_rest = findings(array(), time_s, readings)["signs"]
    assert at_rest.verdict == "warn"
    assert "nothing presses" in at_rest.words
    with pytest.raises(DataError, match="no valid reading"):
        log_fit(array(), time_s, np.full_like(readings, np.nan))


def test_missing_readings_are_no_faults() -> None:
    time_s, readings = press()
    readings[:20, 1] = np.nan
    readings[:, 5] = np.nan
    found = findings(array(), time_s, readings)
    assert found["channels"].words == "no readings: t2.Z"
    assert found["signs"].verdict == "ok"


def test_the_command_compares_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pad, log = tmp_path / "pad.toml", tmp_path / "log.csv"
    channels = '[[taxel_channels]]\nname = "Z"\nkind = "normal"\n'
    pad.write_text(f'name = "pad"\nunit = "uT"\nrange = [-2000, 2000]\ntaxel_count = 3\n{channels}')
    time_s, readings = press(signs=(1, -1, 1), rest=0.0)
    table = np.column_stack([time_s, readings[:, 1::2]])
    np.savetxt(log, table, delimiter=",", header="time_s,a,b,c", comments="")
    for all_columns in ((), ("--columns", "")):
        assert call("check-config", str(pad), "--log", str(log), *all_columns) == 0
        assert "log: signs: fall where the log changes most: t1.Z" in capsys.readouterr().err
    assert call("check-config", str(pad), "--log", str(log), "--columns", "a,b") == 2
    assert "--columns" in capsys.readouterr().err
    config = tmp_path / "left.toml"
    config.write_text('[port]\nurl = "/dev/ttyUSB0"\n')
    assert call("check-config", str(config), "--log", str(log)) == 2
    assert "--log is compared with an array" in capsys.readouterr().err
