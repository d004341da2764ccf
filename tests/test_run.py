"""When `./run` makes the environment anew, with a Python that installs nothing."""

import os
import shutil
import subprocess
from pathlib import Path

from tactiled import resources

_PYTHON = """\
#!/bin/sh
case "$*" in
    -V) echo "Python 3.11.2" ;;
    *"-m venv"*)
        for venv; do :; done
        mkdir -p "$venv/bin" "$venv/lib/python3.11"
        echo "command = python3 -m venv $(pwd -P)/$venv" >"$venv/pyvenv.cfg"
        cp "$0" "$venv/bin/python"
        printf '#!/bin/sh\\necho started\\n' >"$venv/bin/tactiled"
        chmod +x "$venv/bin/tactiled" ;;
esac
"""


def test_an_environment_is_made_once_for_each_folder_and_version_of_python(tmp_path: Path) -> None:
    python, checkout, moved = tmp_path / "python", tmp_path / "a checkout", tmp_path / "moved"
    python.write_text(_PYTHON)
    python.chmod(0o755)
    for folder in ("tactiled", "packages/client", "requirements"):
        (checkout / folder).mkdir(parents=True)
    for file in ("pyproject.toml", "packages/client/pyproject.toml", "requirements/plot.txt"):
        (checkout / file).touch()
    shutil.copy(resources.shipped("run"), checkout)

    def installs(folder: Path) -> bool:
        command, environ = [str(folder / "run"), "listen"], {**os.environ, "PYTHON": str(python)}
        done = subprocess.run(command, env=environ, capture_output=True, text=True, check=True, timeout=60)
        assert done.stdout == "started\n"
        return "installing" in done.stderr

    assert [installs(checkout), installs(checkout)] == [True, False]
    checkout.rename(moved)
    assert [installs(moved), installs(moved)] == [True, False]
    (moved / ".venv/lib/python3.11").rename(moved / ".venv/lib/python3.10")
    assert [installs(moved), installs(moved)] == [True, False]
    (tmp_path / "link").symlink_to(moved)
    assert not installs(tmp_path / "link")
    (moved / "requirements/plot.txt").write_text("new==1\n")
    assert [installs(moved), installs(moved)] == [True, False]
    other = tmp_path / "other"
    shutil.copytree(moved, other, ignore=shutil.ignore_patterns(".venv"))
    (other / ".venv").symlink_to(moved / ".venv")
    assert [installs(other), installs(other), installs(moved)] == [True, False, False]
