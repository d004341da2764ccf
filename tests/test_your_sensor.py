"""The page of other sensors: its files are valid, and its commands print what it shows."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from commands import call
from tutorials import agrees, parts

from tactiled.array import load_array
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import load_scene
from tactiled.wire.layout import load_layout

PAGE = Path(__file__).parents[1] / "docs" / "your-sensor.md"
BLOCKS = [
    re.sub(r"^    ", "", block, flags=re.MULTILINE)
    for block in re.findall(r"(?:^    .*\n|^\n(?=    ))+", PAGE.read_text(), re.MULTILINE)
]
FILES = {
    name: block
    for block in BLOCKS
    if (name := next(iter(re.findall(r"^\s*# (\S+\.(?:toml|py))$", block.lstrip("\n").split("\n")[0])), ""))
}
CHECKS = {
    part.split("\n")[0]: part.split("\n")[1:]
    for block in BLOCKS
    for part in re.split(r"\n\n", block.strip("\n"))
    if part.startswith("tactiled check-config ")
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a clean directory with the files of the page; it is the working directory."""
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_page_has_its_files_and_commands() -> None:
    assert sorted(FILES) == ["board.toml", "fingertip.toml", "lines.toml", "log.py", "pad.toml", "touch.toml"]
    assert len(CHECKS) == 2


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("command", CHECKS)
def test_check_config_prints_what_the_page_shows(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*shlex.split(command)[1:]) == 0
    assert capsys.readouterr().err.split() == " ".join(CHECKS[command]).split()


@pytest.mark.usefixtures("folder")
def test_detect_prints_what_the_page_shows(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = [part.text for part in parts(PAGE, "2. Analyse the log") if part.is_block]
    (write, detect), shown = blocks[1].splitlines(), re.sub(r"\n +", " ", blocks[2])
    assert write == "python log.py > log.csv"
    with Path("log.csv").open("w") as log:
        subprocess.run([sys.executable, "log.py"], stdout=log, check=True)
    assert call(*shlex.split(detect)[1:]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert agrees(shown, last, tolerance=0.01), last


def test_the_emulated_board_of_the_page_sends_its_lines(folder: Path) -> None:
    assert call("check-config", str(folder / "board.toml")) == 0
    layout, scene = load_layout("lines.toml"), load_scene("touch.toml")
    board = EmulatedPort(scene.model_copy(update={"array": "fingertip.toml"}), layout, power_up_s=0.0)
    lines = b"".join(arrival.data for arrival in board.advance(6.0)).decode().splitlines()
    assert {line.count(",") for line in lines[:-1]} == {26}
    pressed = [float(number) for number in lines[-2].split(",")][2::3]
    assert sum(pressed) == pytest.approx(5.0, abs=0.1)  # newtons, as the scene presses


def test_shipped_layouts_name_arrays_that_carry_their_channels() -> None:
    rows = re.findall(r"^\| [^|]+ \| `([\w-]+)`[^|]*\| ", PAGE.read_text().split("## 5.")[1], re.MULTILINE)
    assert len(rows) == 6
    for name in rows:
        layout = load_layout(name)
        assert layout.file.assumed_hello is not None
        assert load_array(layout.file.assumed_hello.array_id).n_channels == layout.n_channels
