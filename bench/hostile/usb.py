"""USB strings and names that become rules and paths."""

import hashlib
import json
import os
import random
import re
import subprocess
import sys
from pathlib import Path

from bench.hostile.attack import Attack, Outcome
from tactiled.errors import ConfigError, OperatorError
from tactiled.setup.apply import remove, write
from tactiled.setup.find import FoundBoard, FoundPort
from tactiled.setup.plan import SetupPlan, make_plan

_INJECTED = '*", RUN+="/bin/touch X", ENV{z}=="'
_N_SERIALS = 20_000
# Quotes, globs, substitutions, separators, control characters, beyond ASCII; and what is permitted.
_ALPHABET = "\"'\\*?[]|,={}$%#+@/ \t\n\x00\x7f\u00e9\U0001f600" + "Aa5-_.:" * 8
_RULE = re.compile(
    r'ACTION=="add", SUBSYSTEM=="tty", SUBSYSTEMS=="usb", ATTRS\{idVendor\}=="1a86", '
    r'ATTRS\{idProduct\}=="7523", ENV\{(ID_SERIAL_SHORT|ID_PATH)\}=="[A-Za-z0-9_.:-]+", GROUP="dialout", '
    r'MODE="0660", SYMLINK\+="tactiled-left", TAG\+="systemd", '
    r'ENV\{SYSTEMD_WANTS\}\+="tactiled@left.service"'
)


def _plan(serial: str, socket: str = "") -> SetupPlan:
    port = FoundPort("/dev/ttyUSB0", serial, "1a86", "7523", socket)
    return make_plan(FoundBoard(port, "board-v1", "wang2019-3x3", 0, "TS0001", 100.0), "left")


def _rules(root: Path) -> list[str]:
    """Rules below a folder, one a line, as udev joins them, without comments."""
    text = "\n".join(path.read_text() for path in sorted(root.rglob("*.rules")))
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def _serials(folder: Path, scale: float) -> Outcome:
    draw = random.Random(24)
    count = max(int(_N_SERIALS * scale), 1)
    serials = [_INJECTED] + ["".join(draw.choices(_ALPHABET, k=draw.randint(1, 20))) for _ in range(count)]
    refused, other = 0, []
    for serial in serials:
        try:
            plan = _plan(serial)
        except ConfigError:
            refused += 1
            continue
        write(plan, folder, lambda _: None)
        other += [rule for rule in _rules(folder) if not _RULE.fullmatch(rule)]
        remove("left", folder, lambda _: None)
    seen = f"{refused} refused, {len(serials) - refused} written, {len(other)} rules of another form"
    return Outcome(seen, not other and 0 < refused < len(serials))


def _no_serial(folder: Path, _: float) -> Outcome:
    plan = _plan("", "pci-0000:00:14.0-usb-0:1:1.0-port0")
    write(plan, folder, lambda _: None)
    (rule,) = _rules(folder)
    by_socket = 'ENV{ID_PATH}=="pci-0000:00:14.0-usb-0:1:1.0"' in rule
    said = any("no serial number" in note for note in plan.notes)
    words = "the USB socket" if by_socket else "every adapter"
    return Outcome(f"the rule matches {words}; {'said' if said else 'not said'}", by_socket and said)


def _outside(folder: Path, _: float) -> Outcome:
    """A list of written files outside of /etc/tactiled, and one inside that names a file elsewhere."""
    victim = folder / "etc/systemd/system/victim.service"
    victim.parent.mkdir(parents=True)
    victim.write_text("mine")
    other = folder / "etc/shadow"
    other.write_text("mine")
    digest = hashlib.sha256(b"mine").hexdigest()
    (folder / "etc/tactiled").mkdir()
    (folder / "etc/evil.setup.json").write_text(json.dumps({"/etc/systemd/system/victim.service": digest}))
    (folder / "etc/tactiled/left.setup.json").write_text(json.dumps({"/etc/shadow": digest}))
    codes, errors = [], ""
    for name in ("../evil", "left"):
        command = [sys.executable, "-m", "tactiled", "setup", name, "--remove", "--root", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        codes.append(done.returncode)
        errors += done.stderr
    kept = victim.exists() and other.exists()
    traceback = "Traceback" in errors
    seen = f"exit codes {codes}, files {'kept' if kept else 'deleted'}, {errors.count(chr(10))} lines"
    return Outcome(seen, kept and codes == [2, 2] and not traceback)


def _odd_files(folder: Path, _: float) -> Outcome:
    plan = _plan("A5")
    answers: list[str] = []
    for kind in ("bytes", "folder", "fifo", "device"):
        root = folder / kind
        for file in plan.files:
            path = root / file.path.lstrip("/")
            path.parent.mkdir(parents=True, exist_ok=True)
            if kind == "bytes":
                path.write_bytes(os.urandom(4096))
            elif kind == "folder":
                path.mkdir()
            elif kind == "fifo":
                os.mkfifo(path)
            else:
                path.symlink_to("/dev/zero")
        try:
            write(plan, root, answers.append)
            remove(plan.name, root, answers.append)
        except OperatorError as error:
            answers.append(f"refused: {error}")
    kept = sum("it is no text file" in answer for answer in answers)
    return Outcome(f"{kept} of {4 * len(plan.files)} kept, one line each", kept == 4 * len(plan.files))


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "usb: serial number as udev rule",
        f"`{_INJECTED}` and {_N_SERIALS} random serial numbers of quotes, globs, controls and emoji",
        "each refused with the reason, or a rule of the one known form",
        _serials,
        short=0.02,
    ),
    Attack(
        "usb: adapter without serial number",
        "empty serial number",
        "a rule for the USB socket, and a note",
        _no_serial,
    ),
    Attack(
        "usb: `setup --remove`",
        "`../evil` with a list of files there; a list in place that names /etc/shadow",
        "exit code 2, nothing deleted",
        _outside,
    ),
    Attack(
        "usb: odd files in place of ours",
        "binary file, folder, FIFO and /dev/zero under every name that `setup` writes",
        "each kept and named in one line",
        _odd_files,
    ),
)
