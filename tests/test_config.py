"""tactiled.toml: every option explained, every fault told at once with its place."""

import re
from pathlib import Path

import pytest

from tactiled import resources
from tactiled.config import Config, config_files, kind_of, load_config, load_configs
from tactiled.errors import ConfigError
from tools.site.reference import config_tables

SHIPPED = resources.shipped("config", "tactiled.toml")


def documented(text: str) -> dict[tuple[str, str], str]:
    """Every key of the file by table, commented out or not."""
    found: dict[tuple[str, str], str] = {}
    table = ""
    for line in text.splitlines():
        if match := re.fullmatch(r"\[([\w.]+)\]", line):
            table = match[1]
        elif match := re.fullmatch(r"(?:# )?(\w+) = (.+)", line):
            found[table, match[1]] = match[2]
    return found


def test_every_option_is_in_the_shipped_file_with_its_default() -> None:
    found = documented(SHIPPED.read_text())
    known = {
        (table.name, key): default for table in config_tables() for key, default in table.defaults.items()
    }
    assert set(found) == set(known)
    for place, default in known.items():
        if place != ("port", "url") and default is not None:
            value = tuple(default) if isinstance(default, tuple) else default
            shown = found[place].replace("true", "True").replace("false", "False")
            assert eval(shown) == (list(value) if isinstance(value, tuple) else value), place


def test_the_shipped_file_loads_and_so_does_all_that_it_shows(tmp_path: Path) -> None:
    assert load_config(SHIPPED).config.port.url.startswith("/dev/serial/by-id/")
    everything = tmp_path / "all.toml"
    everything.write_text(re.sub(r"(?m)^# (\w+ = )", r"\1", SHIPPED.read_text()))
    config = load_config(everything).config
    assert config.session.board_serial == "TS0001"


def test_files_lie_beside_the_configuration_that_names_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    array = resources.shipped("config", "arrays", "wang2019-3x3.toml").read_text()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "skin.toml").write_text(array.replace('"wang2019-3x3"', '"skin"'))
    path = tmp_path / "board.toml"
    path.write_text('[port]\nurl = "/dev/ttyUSB0"\n[board]\narray = "mine/skin.toml"\n')
    monkeypatch.chdir("/")
    assert load_config(path).array.name == "skin"
    assert load_config(path).recording_header().source.array.name == "skin"
    path.write_text('[port]\nurl = "/dev/ttyUSB0"\n[board]\narray = 7\n')
    with pytest.raises(ConfigError, match=r"board\.array"):
        load_config(path)


def test_all_faults_at_once_with_place_and_hint(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(
        """
[port]
uri = "/dev/ttyUSB0"
[samples]
late_after_ms = 100
[samples.clock]
bucket_s = -1
[detect.grip]
gros_p = 0.5
[publish]
endpoints = ["tcp://0.0.0.0:9872"]
[nonsense]
"""
    )
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    text = str(caught.value)
    assert text.startswith(f"{path}:")
    for says in (
        "port.url: missing",
        "port.uri: unknown key; did you mean url?",
        "samples.late_after_ms: unknown key; units belong to the name here: use late_after_s",
        "samples.clock.bucket_s: input should be greater than or equal to 0.1 (got -1)",
        "detect.grip.gros_p: unknown key; did you mean gross_p?",
        "tcp://0.0.0.0:9872 can be reached from other hosts",
        "nonsense: unknown key",
    ):
        assert says in text, text


def test_faults_of_named_files_are_reported_together(tmp_path: Path) -> None:
    array = tmp_path / "array.toml"
    array.write_text('name = "x"\n[[grids]]\nx_mm = [1.0, 0.0]\ny_mm = [0.0]\n')
    path = tmp_path / "t.toml"
    path.write_text(f'[port]\nurl = "/dev/null"\n[board]\nprotocol = "bord-v1"\narray = "{array}"\n')
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert "board.protocol" in str(caught.value)
    assert "board-v1" in str(caught.value)
    assert "x_mm must grow" in str(caught.value)


def test_an_array_of_other_size_than_the_scan_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.toml"
    path.write_text('[port]\nurl = "/dev/null"\n[board]\narray = "normal-4x4"\n')
    with pytest.raises(
        ConfigError, match=r"normal-4x4 has 16 taxels and 16 channels, but a scan of tactiled-board has 36"
    ):
        load_config(path)


def test_the_port_of_the_command_line_wins() -> None:
    assert load_config(SHIPPED, "/dev/ttyACM7").config.port.url == "/dev/ttyACM7"


def test_a_port_that_is_no_table_is_refused_beside_one_of_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('port = "/dev/ttyACM0"\n')
    with pytest.raises(ConfigError, match="port: "):
        load_config(tmp_path / "a.toml", "/dev/ttyACM7")


def board_file(folder: Path, serial: str | None, text: str = "", url: str = "") -> Path:
    path = folder / f"{serial}.toml"
    pinned = f'[session]\nboard_serial = "{serial}"\n' if serial else ""
    path.write_text(f'[port]\nurl = "{url or f"/dev/{serial}"}"\n{pinned}{text}')
    return path


def test_a_directory_stands_for_the_configurations_in_it(tmp_path: Path) -> None:
    one, two = (board_file(tmp_path, serial) for serial in ("TS0001", "TS0002"))
    (tmp_path / "skin.toml").write_text(
        resources.shipped("config", "arrays", "wang2019-3x3.toml").read_text()
    )
    (tmp_path / "frames.toml").write_text(resources.shipped("protocols", "legacy-9.toml").read_text())
    calibration = resources.shipped("config", "calibration", "wang2019-3x3.toml").read_text()
    (tmp_path / "forces.toml").write_text(calibration)
    (tmp_path / ".TS0003.toml").write_text("not TOML")
    (tmp_path / "TS0004.toml~").write_text("not TOML")
    assert config_files([tmp_path]) == [one, two]
    assert [setup.config.session.board_serial for setup in load_configs([one, two])] == ["TS0001", "TS0002"]
    with pytest.raises(ConfigError, match="is named twice"):
        config_files([tmp_path, two])
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="no configuration"):
        config_files([tmp_path / "empty"])


@pytest.mark.parametrize(
    ("first", "second", "says"),
    [
        ("[metrics]\nport = 9874", "[metrics]\nport = 9875", "metrics.port: 9874 in {0}, but 9875 in {1}"),
        ("[metrics]\nport = 9874", "", "metrics.port: 9874 in {0}, but 0 in {1}"),
        ('[publish]\nkeys = "/k"', "", 'publish.keys: "/k" in {0}, but left out in {1}'),
        (
            "[publish]\nhistory_mb = 1.0",
            "",
            "publish.history_mb: 1.0 in {0}, but 4.0 in {1}",
        ),
        (
            '[publish]\nendpoints = ["tcp://127.0.0.1:9872"]',
            '[publish]\nendpoints = ["tcp://127.0.0.1:9872", "ipc:///tmp/a.ipc"]',
            'publish.endpoints: ["tcp://127.0.0.1:9872"] in {0}, but ',
        ),
        (
            '[record]\ndirectory = "/var/lib/tactiled"',
            '[record]\ndirectory = "/var/lib/tactiled"',
            'record.directory: "/var/lib/tactiled" in both {0} and {1}',
        ),
    ],
)
def test_what_boards_of_one_process_must_agree_on_is_named(
    tmp_path: Path, first: str, second: str, says: str
) -> None:
    files = [board_file(tmp_path, "TS0001", first), board_file(tmp_path, "TS0002", second)]
    with pytest.raises(ConfigError) as caught:
        load_configs(files)
    assert says.format(*files) in str(caught.value)


def test_boards_of_one_process_have_names_and_ports_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    one, same = board_file(tmp_path, "TS0001"), board_file(tmp_path / "other", "TS0001")
    unnamed = board_file(tmp_path, None, url="/dev/ttyUSB0")
    with pytest.raises(ConfigError) as caught:
        load_configs([one, same, unnamed])
    text = str(caught.value)
    assert f'session.board_serial: "TS0001" in both {one} and {same}' in text
    assert f'port.url: "/dev/TS0001" in both {one} and {same}' in text
    assert f"{unnamed}: session.board_serial: missing" in text


def test_the_faults_of_all_configurations_are_reported_together(tmp_path: Path) -> None:
    files = [board_file(tmp_path, serial, "[nonsense]\n") for serial in ("TS0001", "TS0002")]
    with pytest.raises(ConfigError) as caught:
        load_configs([*files, board_file(tmp_path, "TS0003")])
    assert all(f"{file}: nonsense: unknown key" in str(caught.value) for file in files)


def board_config(tmp_path: Path, board: str) -> Path:
    path = tmp_path / "board.toml"
    path.write_text(f'[port]\nurl = "/dev/ttyUSB0"\n[board]\n{board}')
    return path


def test_the_calibration_is_the_nominal_one_a_file_or_none(tmp_path: Path) -> None:
    nominal = load_config(board_config(tmp_path, "")).pipeline
    assert nominal.force
    assert nominal.calibration is not None
    assert nominal.calibration.nominal
    text = resources.shipped("config", "calibration", "wang2019-3x3.toml").read_text()
    (tmp_path / "mine.toml").write_text(
        text.replace('name = "nominal"', 'name = "mine"').replace("nominal = true", "nominal = false")
    )
    mine = load_config(board_config(tmp_path, 'calibration = "mine.toml"\n'))
    assert mine.pipeline.calibration is not None
    assert mine.pipeline.calibration.name == "mine"
    assert mine.recording_header().pipeline == mine.pipeline  # a replay needs it
    off = load_config(board_config(tmp_path, 'calibration = "off"\n')).pipeline
    assert (off.force, off.calibration) == (False, None)


def test_an_array_without_a_calibration_has_unknown_forces(tmp_path: Path) -> None:
    array = resources.shipped("config", "arrays", "wang2019-3x3.toml").read_text()
    (tmp_path / "skin.toml").write_text(array.replace('"wang2019-3x3"', '"skin"'))
    found = load_config(board_config(tmp_path, 'array = "skin.toml"\n')).pipeline
    assert (found.force, found.calibration) == (True, None)
    with pytest.raises(ConfigError, match=r"board\.calibration: .*calibrate this array"):
        load_config(board_config(tmp_path, 'array = "skin.toml"\ncalibration = "wang2019-3x3"\n'))
    with pytest.raises(ConfigError, match=r"board\.calibration"):
        load_config(board_config(tmp_path, 'calibration = "missing.toml"\n'))


def test_an_array_file_without_channels_is_an_array() -> None:
    assert kind_of({"name": "pad", "taxel_count": 16}) == "array"


@pytest.mark.parametrize(
    ("clock", "fault"),
    [
        ("window_buckets = 301", "samples.clock.window_buckets: input should be less than or equal to 300"),
        ("window_buckets = 20000\nbucket_s = 0.01", "samples.clock.bucket_s: input should be greater than"),
        ("bucket_s = 5e-324", "samples.clock.bucket_s: input should be greater than or equal to 0.1"),
    ],
)
def test_the_fit_of_the_clock_has_a_largest_window(tmp_path: Path, clock: str, fault: str) -> None:
    path = tmp_path / "t.toml"
    path.write_text(f'[port]\nurl = "/dev/null"\n[samples.clock]\n{clock}\n')
    with pytest.raises(ConfigError, match=re.escape(fault)):
        load_config(path)
    path.write_text('[port]\nurl = "/dev/null"\n[samples.clock]\nwindow_buckets = 300\nbucket_s = 0.1\n')
    assert load_config(path).config.samples.clock.window_buckets == 300


def test_every_whole_number_of_the_configuration_has_an_upper_limit() -> None:
    for table, schema in Config.model_json_schema()["$defs"].items():
        for key, option in schema.get("properties", {}).items():
            for kind in (option, *option.get("anyOf", ())):
                if kind.get("type") == "integer":
                    assert {"maximum", "exclusiveMaximum"} & kind.keys(), (table, key)
