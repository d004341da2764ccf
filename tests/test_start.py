"""Mistakes in a call are reported before numpy is imported, which takes most of a second."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bench.__main__ import BENCHES
from tactiled.errors import install_command

HEAVY = ["numpy", "scipy", "pydantic", "rich"]
ROOT = Path(__file__).resolve().parent.parent
LOADED = f"""\
import json, sys
from tactiled.cli import main
told = []
for arguments in json.loads(sys.argv.pop()):
    sys.argv[:] = ["tactiled", *arguments]
    try:
        main()
    except SystemExit as end:
        told.append([arguments, end.code, [name for name in {HEAVY} if name in sys.modules]])
print(json.dumps(told))
"""


def heavy_imports(calls: list[list[str]], cwd: Path) -> Any:
    """Each of the calls, made one after the other in one process, exit code, and slow libraries by then."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, json.dumps(calls)],
        capture_output=True, text=True, cwd=cwd, timeout=60, check=True,
    )  # fmt: skip
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def without(module: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A call where a library is not installed."""
    script = f"import sys; sys.modules[{module!r}] = None; from tactiled.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", script, *arguments],
        capture_output=True, text=True, cwd=cwd, timeout=60, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [["demo"], ["detect", "log.csv", "--plot", "a.png"]],
)
def test_a_picture_without_matplotlib_names_the_command_that_installs_it(
    arguments: list[str], tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text("time_s,a\n0.0,0.0\n")
    done = without("matplotlib", *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert "needs matplotlib: pip install 'matplotlib>=" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_command_that_installs_an_extra_names_its_libraries() -> None:
    """No index has tactiled; the libraries can be installed from anywhere."""
    assert install_command("parquet").startswith("pip install ")
    assert "tactiled" not in install_command("parquet")
    assert "zenoh" in install_command("", "tactiled-zenoh")
    assert install_command("web", "no-such") == "pip install '.[web]' in the checkout of no-such"


def test_benches_need_matplotlib_for_pictures_alone() -> None:
    modules = ", ".join(bench.module for bench in BENCHES.values())
    script = f"import sys; sys.modules['matplotlib'] = None; import {modules}"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60, cwd=ROOT)


MISTAKES = [
    ["frobnicate"],
    ["run"],
    ["run", "--nonsense"],
    ["run", "--config", "none.toml"],
    ["run", "--config", "broken.toml"],
    ["record", "a.mcap"],
    ["record", "a.mcap", "--config", "none.toml"],
    ["replay"],
    ["replay", "none.mcap"],
    ["recover", "none.mcap"],
    ["export", "none.mcap"],
    ["export", "none.mcap", "--csv", "x.csv"],
    ["emulate"],
    ["emulate", "--protocol", "none", "--link", "x"],
    ["emulate", "--scene", "none.toml", "--link", "x"],
    ["emulate", "--faults", "none.toml", "--link", "x"],
    ["detect", "none.csv"],
    ["detect", "log.csv", "--array", "none"],
    ["detect", "log.csv", "--array", "broken.toml"],
    ["detect", "log.csv", "--speed", "-1"],
    ["tune", "--quiet", "log.csv"],
    ["tune", "--quiet", "none.csv", "--motion", "none.csv"],
    ["bench", "none"],
    ["bench", "clock", "--plot", "x.png"],
    ["check-config"],
    ["check-config", "none.toml"],
    ["check-config", "broken.toml"],
    ["doctor"],
    ["listen", "--topic", "slipp"],
    ["listen", "nonsense"],
    ["command", "tare", "force"],
]


def test_help_and_mistakes_in_a_call_import_no_slow_library(tmp_path: Path) -> None:
    (tmp_path / "broken.toml").write_text("[board\n")
    (tmp_path / "log.csv").write_text("time_s,a\n0.0,0.0\n")
    told = [[["--help"], 0, []], *([mistake, 2, []] for mistake in MISTAKES)]
    assert heavy_imports([["--help"], *MISTAKES], cwd=tmp_path) == told


def test_the_daemon_does_without_what_only_pictures_and_statistics_need() -> None:
    """`scipy.special` is 24 MB; `scipy.stats` and `scipy.optimize` would be as much again."""
    script = (
        "import sys, tactiled.config, tactiled.daemon.service, tactiled.offline;"
        "print([m for m in ('scipy.stats', 'scipy.optimize', 'matplotlib', 'rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
