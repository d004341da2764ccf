"""Configuration files that no parser expects, and disks that do not take a recording."""

import os
import random
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from bench.hostile.attack import Attack, Outcome
from tactiled import resources
from tactiled.config import load_config
from tactiled.errors import ConfigError

_LONGEST_S = 30.0  # a start takes one or two seconds; what is read without end never ends
_N_MUTATIONS = 5_000
_ODD_VALUES = ("-1", "1e308", "5e-324", "9" * 300, "[]", "{}", '"\\u0000"', "nan", "true")
_PORT = '[port]\nurl = "/dev/null"\n'
_TEXTS = {
    "port.url (line 2)": "[port]\nurl = " + "[" * 5000 + "]" * 5000,
    "port.baud (line 2)": "[port]\nbaud = " + "9" * 5000,
    "a key of more than 32 parts": '"a" . ' * 100_000 + "b = 1",
    "port.rate (line 2)": "[port]\nrate = 0x" + "f" * 100_000,
    "samples.clock.window_buckets": f"{_PORT}[samples.clock]\nwindow_buckets = 20000\nbucket_s = 0.01\n",
    "/nonexistent: no such folder": f'{_PORT}[publish]\nendpoints = ["ipc:///nonexistent/a.ipc"]\n',
    "in the root folder": f'{_PORT}[publish]\nendpoints = ["ipc:///nonexistent"]\n',
}
_FULL_DISK = """
import logging, os, sys, time
from pathlib import Path
from tactiled.daemon.operations.recorder import Recorder
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.rotation import RecordParams
logging.basicConfig(format="%(message)s", stream=sys.stdout, level=logging.WARNING)
params = RecordParams(directory=sys.argv[1], min_free_mb=0, sync_s=0.05)
with Recorder(params, Header(load_board("board-v1", "wang2019-3x3"))) as recorder:
    ends_s = time.monotonic() + float(sys.argv[2])
    k = 0
    while time.monotonic() < ends_s:
        for _ in range(20):
            k += 1
            recorder.received(Read(k * 0.001, 1.7e9, os.urandom(4096)), (), None)
        recorder.report(time.monotonic())
        time.sleep(0.02)
"""


def _answer(command: Sequence[str]) -> tuple[int | None, str]:
    """Exit code and stderr of `tactiled`; None where it did not end."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "tactiled", *command],
            capture_output=True,
            text=True,
            timeout=_LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None, ""
    return done.returncode, done.stderr


def _judged(answers: dict[str, tuple[int | None, str]], named: Sequence[str]) -> Outcome:
    codes = sorted({str(code) for code, _ in answers.values()})
    wrong = [
        what
        for (what, (code, said)), name in zip(answers.items(), named, strict=True)
        if code != 2 or "Traceback" in said or name not in said
    ]
    seen = f"{len(answers)} files, exit codes {', '.join(codes)}, {len(wrong)} not named"
    return Outcome(seen + (f": {', '.join(wrong)}" if wrong else ""), not wrong)


def _texts(folder: Path, scale: float) -> Outcome:
    answers: dict[str, tuple[int | None, str]] = {}
    named: list[str] = []
    for name, text in list(_TEXTS.items())[: max(round(len(_TEXTS) * scale), 1)]:
        file = folder / f"{len(answers)}.toml"
        file.write_text(text)
        answers[name] = _answer(["check-config", str(file)])
        named.append(name)
    return _judged(answers, named)


def _no_files(folder: Path, scale: float) -> Outcome:
    os.mkfifo(folder / "fifo.toml")
    (folder / "zero.toml").symlink_to("/dev/zero")
    (folder / "folder.toml").mkdir()
    tries = [
        (key, kind) for kind in ("zero", "fifo", "folder") for key in ("array", "protocol", "calibration")
    ]
    tries += [("configuration", "zero"), ("configuration", "fifo")]
    answers: dict[str, tuple[int | None, str]] = {}
    named: list[str] = []
    for key, kind in tries[: max(round(len(tries) * scale), 1)]:
        file = folder / "t.toml" if key != "configuration" else folder / f"{kind}.toml"
        if key != "configuration":
            file.write_text(f'{_PORT}[board]\n{key} = "{folder / kind}.toml"\n')
        answers[f"{key} {kind}"] = _answer(["run", "--config", str(file)])
        named.append(f"{kind}.toml: is not a regular file")
    return _judged(answers, named)


def _mutations(folder: Path, scale: float) -> Outcome:
    """Change the shipped file at random: bytes replaced, cut, doubled, numbers made huge."""
    draw = random.Random(24)
    shipped = resources.shipped("config", "tactiled.toml").read_text()
    lines = re.findall(r"(?m)^(?:# )?(\w+ = .+|\[[\w.]+\])$", shipped)
    file = folder / "t.toml"
    good = refused = 0
    slowest_s = 0.0
    for _ in range(max(int(_N_MUTATIONS * scale), 1)):
        chosen = [line for line in lines if line[0] == "[" or draw.random() < 0.9]
        for _ in range(draw.randint(0, 2)):
            k = draw.randrange(len(chosen))
            key, equals, value = chosen[k].partition("=")
            chosen[k] = draw.choice(
                [
                    f"{key}{equals}{draw.choice(_ODD_VALUES)}",
                    key * draw.randint(0, 40),
                    value,
                    chosen[k][: draw.randrange(len(chosen[k]) + 1)],
                ]
            )
        file.write_text("\n".join(chosen))
        began_s = time.perf_counter()
        try:
            load_config(file)
            good += 1
        except ConfigError:
            refused += 1
        slowest_s = max(slowest_s, time.perf_counter() - began_s)
    seen = f"{refused} refused, {good} valid, no other answer, slowest {slowest_s:.2f} s"
    return Outcome(seen, bool(good and refused))


def _full_disk(folder: Path, scale: float) -> Outcome:
    """Record onto a disk of 1 MB, which is mounted where only this process sees it."""
    seconds = max(30.0 * scale, 2.0)
    mount = f'mount -t tmpfs -o size=1m hostile "{folder}" && exec "$0" -c "$1" "{folder}" {seconds}'
    command = ["unshare", "--mount", "--map-root-user", "sh", "-c", mount, sys.executable, _FULL_DISK]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds + _LONGEST_S, check=False)
    if done.returncode != 0:
        words = done.stderr.strip().splitlines()
        return Outcome(f"not tried, this host lets no user mount: {words[-1] if words else ''}", held=True)
    lines = [line for line in done.stdout.splitlines() if "in no file" in line]
    named = [line for line in lines if "the disk is full" in line]
    slow = [line for line in lines if "too slow" in line]
    seen = f"{len(lines)} lines of lost reads, {len(named)} name the full disk, {len(slow)} a slow one"
    return Outcome(seen, bool(lines) and len(named) == len(lines))


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "configuration: texts that exhaust a parser, values without limit",
        "5,000 brackets, 5,000 and 100,000 digits, 100,000 dots, 20,000 buckets, sockets without a place",
        "exit code 2, the place named, no traceback",
        _texts,
        short=0.3,
    ),
    Attack(
        "configuration: what is no file",
        "/dev/zero, a FIFO and a folder as configuration, array, layout and calibration of `tactiled run`",
        "exit code 2, the file named, nothing read without end",
        _no_files,
        short=0.1,
    ),
    Attack(
        "configuration: random changes of the shipped file",
        f"{_N_MUTATIONS} files with keys and values changed, cut, repeated or made huge",
        "valid, or refused with faults",
        _mutations,
        short=0.01,
    ),
    Attack(
        "configuration: recording onto a full disk",
        "a disk of 1 MB, 4 MB a second",
        "each line of lost reads says that the disk is full",
        _full_disk,
        short=0.05,
    ),
)
