"""Commands of a page, run as a reader types them, and what the page says that they print.

Indented blocks of a page are

- a file, if the first line is ``# NAME.toml``;
- commands (lines that begin with one of `_PROGRAMS`), each followed by what it prints;
- otherwise what the newest command that ends by itself has printed.

``tactiled emulate``, ``tactiled run`` and qemu have a terminal each and run until the text says Ctrl-C; the
next command is typed in a new terminal. A program that ``python`` runs has a terminal, too, until the page
shows what it prints: then it must end by itself. ``(qemu)`` is the prompt of qemu. ``/dev/pts/0`` on a page
stands for the port that qemu printed.

Lines that a page shows occur in this order in what the command printed; between them there may be others. An
object of JSON has at least the shown fields. In other lines ``...`` stands for any words. Numbers may differ
by a tenth, if not stated otherwise.
"""

import json
import re
import shlex
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

import pytest
from patience import PATIENCE_S

_ROOT = Path(__file__).parents[2]
_QEMU, _PROMPT = "qemu-system-arm", "(qemu)"
_PROGRAMS = ("tactiled", "python", "cd", "cc", "./vectors", "arm-none-eabi-gcc", _QEMU, _PROMPT)
_STAYS = ("emulate", "run")
_PORT = "/dev/pts/0"
_LATE = ('"behind"', "flags overruns", "load on the host")  # words of `emulate` and `doctor`
_PART = re.compile(r"(?P<block>(?:^ {4}.*\n|^\n(?= {4}))+)|(?P<text>.+\n)|\n", re.MULTILINE)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
_TOLERANCE = 0.1  # of a number: the emulated board runs in real time, and its clock is not that of the host


class Part(NamedTuple):
    """Block of a page without its indentation, or a line of text."""

    is_block: bool
    text: str


def parts(page: Path, heading: str) -> Iterator[Part]:
    """Yield blocks and text of one section of a page."""
    section = re.split(rf"^#+ {re.escape(heading)}\n", page.read_text(), flags=re.MULTILINE)[1]
    for found in _PART.finditer(re.split(r"^## ", section, flags=re.MULTILINE)[0]):
        if block := found["block"]:
            yield Part(is_block=True, text=textwrap.dedent(block).strip("\n"))
        elif found["text"]:
            yield Part(is_block=False, text=found["text"])


class Reader:
    """Somebody who does in a folder what a page says.

    Numbers that are printed may differ from those of the page by the part `tolerance`. With `may_skip`, a
    test is skipped if lines differ and an emulated board was too late.

    Attributes
    ----------
    commands : list of str
        What was run and ended by itself.
    last : str
        Last line that the newest of these printed.
    """

    def __init__(self, folder: Path, tolerance: float = _TOLERANCE, *, may_skip: bool = False) -> None:
        self.commands: list[str] = []
        self.last = ""
        self._folder, self._tolerance, self._may_skip = folder, tolerance, may_skip
        self._directory = folder  # of the newest terminal
        self._port = _PORT  # of the emulated microcontroller
        self._printed: list[str] = []  # by the newest command; what the page has shown of it is removed
        self._terminals: dict[Path, subprocess.Popen[bytes]] = {}
        self._program: tuple[str, Path] | None = None  # a `python` command that runs, and its terminal

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for terminal in self._terminals.values():
            terminal.kill()
            terminal.communicate()

    def follow(self, page: Path, heading: str) -> None:
        """Do all that a section says, and compare what is printed with what it shows."""
        for part in parts(page, heading):
            if not part.is_block:
                if "Ctrl-C" in part.text:
                    self._stop()
            elif name := re.match(r"# (\S+\.toml)\n", part.text):
                (self._folder / name[1]).write_text(part.text + "\n")
            else:
                self._read(part.text)

    def _read(self, block: str) -> None:
        """Run the commands of a block; compare the lines between them."""
        shown: list[str] = []
        for line in re.sub(r"\\\n +", "", block).splitlines():
            if line.split(" ")[0] in _PROGRAMS:
                self._compare(shown)
                shown = []
                self._run(line.split("  #")[0].replace(_PORT, self._port))
            elif line.startswith(" ") and shown:  # one line, which the page had to break
                shown[-1] += f" {line.strip()}"
            elif line:
                shown.append(line)
        self._compare(shown)

    def _run(self, command: str) -> None:
        name, *arguments = shlex.split(command)
        if name == "python":
            arguments[0] = str(_ROOT / arguments[0])
            self._program = command, self._open([sys.executable, *arguments])
            return
        if name == "cd":
            self._directory /= arguments[0]
            return
        if name == _PROMPT:
            self._type(" ".join(arguments))
            return
        if name == _QEMU:
            self._port = self._start([name, *arguments], until=r"/dev/pts/\d+")
            return
        program = ["sh", "-c", command]
        if name == "tactiled":
            program = [sys.executable, "-m", "tactiled", *arguments]
            if arguments[0] in _STAYS:
                self._start(program, until=".")
                return
        done = subprocess.run(
            program, cwd=self._directory, text=True, capture_output=True, timeout=PATIENCE_S, check=False
        )
        assert done.returncode == 0, f"{command}: {done.stderr}"
        self._take(command, done.stdout + done.stderr)

    def _start(self, program: list[str], until: str) -> str:
        """Run a program that stays, and return the first of what it prints that matches `until`."""
        printed = self._open(program)
        self._directory = self._folder
        end_s = time.monotonic() + PATIENCE_S
        while (found := re.search(until, printed.read_text())) is None:
            assert time.monotonic() < end_s, f"{program} has not started: {printed.read_text()}"
            time.sleep(0.05)
        return found[0]

    def _type(self, line: str) -> None:
        """Type a line in the terminal of qemu."""
        (terminal,) = (terminal for terminal in self._terminals.values() if _QEMU in str(terminal.args))
        assert terminal.stdin is not None
        terminal.stdin.write(f"{line}\n".encode())
        terminal.stdin.flush()

    def _open(self, program: list[str]) -> Path:
        """Run a program in a terminal of its own, and return the file of what it prints."""
        printed = self._folder / f"terminal-{len(self._terminals)}.txt"  # a pipe would be full some time
        with printed.open("w") as screen:
            terminal = subprocess.Popen(
                program,
                cwd=self._directory,
                stdin=subprocess.PIPE,
                stdout=screen,
                stderr=subprocess.STDOUT,
            )
        self._terminals[printed] = terminal
        return printed

    def _finish(self) -> None:
        """Wait for the end of a `python` program; what it printed is compared next."""
        if self._program is not None:
            command, printed = self._program
            self._program = None
            assert self._terminals[printed].wait(PATIENCE_S) == 0, printed.read_text()
            self._take(command, printed.read_text())

    def _take(self, command: str, printed: str) -> None:
        """Keep what a command has printed, which has ended."""
        self.commands.append(command)
        self._printed = printed.splitlines()
        self.last = self._printed[-1] if self._printed else ""

    def _compare(self, shown: list[str]) -> None:
        if shown:
            self._finish()
        for line in shown:
            for number, printed in enumerate(self._printed):
                if agrees(line, printed, self._tolerance):
                    del self._printed[: number + 1]
                    break
            else:
                screens = [*self._printed, *(screen.read_text() for screen in self._terminals)]
                if self._may_skip and any(words in screen for words in _LATE for screen in screens):
                    pytest.skip("this host is too slow for an emulated board in real time")
                pytest.fail(f"the page shows\n  {line}\nand printed was\n  " + "\n  ".join(self._printed))

    def _stop(self) -> None:
        """Press Ctrl-C in each terminal, the newest first."""
        for printed, terminal in reversed(self._terminals.items()):
            terminal.send_signal(signal.SIGINT)
            terminal.communicate(timeout=PATIENCE_S)
            assert "Traceback" not in printed.read_text()
        self._terminals.clear()


def agrees(shown: str, printed: str, tolerance: float = _TOLERANCE) -> bool:
    """Return True where a printed line is the one that a page shows."""
    if shown.startswith("{"):
        if not printed.startswith("{"):
            return False
        fields = json.loads(re.sub(r",? ?\.\.\.}$", "}", shown))
        message = json.loads(printed)
        return all(
            name in message and _is_near(value, message[name], tolerance) for name, value in fields.items()
        )
    words, other = shown.split(), printed.split()
    if "..." in words and len(other) >= len(words) - 1:
        begin = words.index("...")
        end = len(words) - begin - 1
        words, other = words[:begin] + words[begin + 1 :], other[:begin] + other[len(other) - end :]
    return len(words) == len(other) and all(
        _is_like(word, of_other, tolerance) for word, of_other in zip(words, other, strict=True)
    )


def _is_near(value: Any, other: Any, tolerance: float) -> bool:
    if isinstance(value, bool | str | list):
        return bool(value == other)
    return bool(other == pytest.approx(value, rel=tolerance))


def _is_like(word: str, other: str, tolerance: float) -> bool:
    """Compare words, and the numbers in them."""
    if _NUMBER.sub("#", word) != _NUMBER.sub("#", other):
        return False
    pairs = zip(_NUMBER.findall(word), _NUMBER.findall(other), strict=True)
    return all(_is_near(float(number), float(printed), tolerance) for number, printed in pairs)
