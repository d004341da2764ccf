"""The command line: exit codes, one clear line for each fault, machine output apart from words."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from commands import call

from tactiled import compiled
from tactiled.version import __version__

ROOT = Path(__file__).resolve().parent.parent


class Done(NamedTuple):
    """Exit code of a call, and what it printed."""

    code: int
    stdout: str
    stderr: str


Tactiled = Callable[..., Done]


@pytest.fixture
def tactiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Tactiled:
    """Runs the program in this process, in a folder of its own."""

    def run(*arguments: str) -> Done:
        monkeypatch.chdir(tmp_path)
        code = call(*arguments)
        return Done(code, *capsys.readouterr())

    return run


def test_the_version_is_said(tactiled: Tactiled) -> None:
    program = subprocess.run(
        [sys.executable, "-m", "tactiled", "--version"], capture_output=True, text=True, check=True
    )
    assert program.stdout == f"tactiled, version {__version__}\n"
    said = f"path of a scan: {compiled.path_words()}"
    assert said in tactiled("check-config", str(ROOT / "config" / "tactiled.toml")).stderr.splitlines()


VERBS = [
    "demo", "run", "emulate", "listen", "detect", "check-config",
    "record", "replay", "recover", "export", "command", "keys", "doctor", "tune",
]  # fmt: skip


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_each_verb_has_an_example(tactiled: Tactiled, verb: str) -> None:
    done = tactiled(verb, "--help")
    assert done.code == 0
    assert f"Example: tactiled {verb}" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["run"], "--config FILE, or --port PORT"),
        (["run", "--config", "none.toml"], "none.toml: no such file"),
        (["emulate"], "either --link NAME or --tcp"),
        (["emulate", "--scene", "none", "--link", "x"], "demo"),
        (["emulate", "--scene", "bad.toml", "--link", "x"], "period_mm"),
        (["emulate", "--protocol", "none", "--link", "x"], "board-v1"),
        (["emulate", "--seed", "-1", "--link", "x"], "--seed"),
        (["emulate", "--rig", "/dev/null"], "--rig: /dev/null: File exists; name a folder"),
        (["listen", "nonsense"], "nonsense"),
        (["listen", "--topic", "slipp"], "no topic 'slipp'; there are: slip"),
        (["detect", "none.csv"], "none.csv"),
        (["detect", "none.csv", "--only", "grp"], "no topic 'grp'; there are: slip, contact, grip, texture"),
        (["detect", "none.csv", "--sliding", "5"], "'5' is not two numbers with a colon between"),
        (["detect", "none.csv", "--sliding", "5:2"], "the second number must be larger"),
        (["detect", "none.csv", "--period", "2:"], "'2:' is not two numbers"),
        (["check-config"], "FILE"),
        (["record", "a.mcap"], "--config FILE, or --port PORT"),
        (["record", "none/a.mcap", "--port", "x"], "none: No such file or directory; make the directory"),
        (["replay"], "FILES"),
        (["replay", "none.mcap"], "none.mcap: cannot be read"),
        (["replay", "bad.toml"], "bad.toml: not a recording of tactiled"),
        (["recover", "bad.toml"], "bad.toml: not a recording of tactiled"),
        (["export", "bad.toml"], "--csv"),
        (["export", "none.mcap", "--csv", "x.csv"], "none.mcap: cannot be read"),
        (["command", "tare", "force"], "FIELD=VALUE"),
        (["keys", "make", "a/b"], "letters"),
        (["tune", "--quiet", "a.csv"], "both --quiet FILE and --motion FILE"),
        (["tune", "--quiet", "none.csv", "--motion", "none.csv"], "none.csv: cannot be read"),
        (["tune", "nonsense"], "nonsense"),
        (["frobnicate"], "frobnicate"),
    ],
)
def test_usage_and_configuration_faults_end_in_2_with_one_clear_line(
    tactiled: Tactiled, arguments: list[str], says: str, tmp_path: Path
) -> None:
    (tmp_path / "bad.toml").write_text(
        'name = "bad"\nsurface = { kind = "grooves", period_mm = -1.2 }\n'
        '[[phases]]\nkind = "rest"\nduration_s = 1.0\n'
    )
    done = tactiled(*arguments)
    assert (done.code, done.stdout) == (2, "")
    assert says in done.stderr


def test_missing_or_world_readable_files_of_a_configuration_are_reported(
    tactiled: Tactiled, tmp_path: Path
) -> None:
    path = tmp_path / "t.toml"
    path.write_text('[port]\nurl = "x"\n[record]\ndirectory = "none"\n')
    done = tactiled("check-config", "t.toml")
    assert done.code == 0
    assert (
        "warning: record.directory: none: no such directory; the daemon starts without recording"
        in done.stderr
    )
    path.write_text('[port]\nurl = "x"\n[publish]\nendpoints = ["tcp://0.0.0.0:9872"]\nkeys = "keys"\n')
    done = tactiled("check-config", "t.toml")
    assert (done.code, done.stdout) == (2, "")
    assert "t.toml: publish.keys: keys: no such folder" in done.stderr


def test_a_closed_pipe_is_no_error() -> None:
    shell = f"{sys.executable} -m tactiled replay --help | head -c 10"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", shell], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stderr == ""


GRID = """\
name = "mine"
[[grids]]
x_mm = [0.0, 4.0, 8.0]
y_mm = [0.0, 4.0]
[[taxel_channels]]
name = "z"
kind = "normal"
"""


@pytest.mark.parametrize("name", ["board-v1", "legacy-9"])
def test_layout_files_are_checked_as_such(tactiled: Tactiled, name: str, tmp_path: Path) -> None:
    shipped = (ROOT / "protocols" / f"{name}.toml").read_text()
    (tmp_path / "mine.toml").write_text(shipped)
    done = tactiled("check-config", "mine.toml")
    assert done.code == 0, done.stderr
    assert json.loads(done.stdout)["channels"] == (36 if name == "board-v1" else 9)
    assert "valid (layout " in done.stderr
    (tmp_path / "mine.toml").write_text(shipped.replace("byte_order", "byte_ordre"))
    done = tactiled("check-config", "mine.toml")
    assert done.code == 2
    assert "byte_ordre" in done.stderr


def test_an_array_file_is_checked_as_such(tactiled: Tactiled, tmp_path: Path) -> None:
    """It was taken for a configuration: "name: unknown key", "port: missing"."""
    (tmp_path / "mine.toml").write_text(GRID)
    done = tactiled("check-config", "mine.toml")
    assert done.code == 0, done.stderr
    assert json.loads(done.stdout)["name"] == "mine"
    assert "mine.toml: valid (array mine: 6 taxels on 1 pad, 6 channels (normal)" in done.stderr
