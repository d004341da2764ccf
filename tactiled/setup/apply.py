"""Write the files of a plan, and remove them again; doing either twice changes nothing more."""

import contextlib
import hashlib
import json
import re
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tactiled import tomlfile
from tactiled.config import kind_of
from tactiled.errors import ConfigError, DataError, OperatorError
from tactiled.events.endpoints import DEFAULT_ENDPOINT
from tactiled.outside import json_of, name_of, read_text
from tactiled.setup.plan import SetupPlan, TakenPorts

Say = Callable[[str], None]
_LONGEST_S = 200.0  # of a command; systemd gives the start of the unit 180 s
# Where a plan has files: nothing else is removed, whatever a list of written files says.
_OURS = re.compile(r"/etc/(tactiled|sysusers\.d|systemd/system|udev/rules\.d)/[A-Za-z0-9][A-Za-z0-9_.@-]*")


def write(plan: SetupPlan, root: Path, say: Say) -> None:
    """Write what is missing. A file that differs is kept: somebody has edited it.

    `OperatorError` if a file cannot be written.
    """
    written = _read_manifest(root, plan.name)
    others = _written_for_others(root, plan.name)
    for file in plan.files:
        path = _under(root, file.path)
        there = _text_of(path)
        packaged = file.path.replace("/etc/", "/usr/lib/", 1)
        if file.shared and not path.exists() and _text_of(_under(root, packaged)) == file.text:
            say(f"unchanged  {packaged}, of the Debian package")
            continue  # a copy in /etc would hide what the next version of the package brings
        if there == file.text:
            say(f"unchanged  {file.path}")
            if file.path not in written and file.path not in others:
                continue  # it was here before: removal must leave it
        elif path.exists() and (
            there is None or _digest(there) not in {written.get(file.path), *others.get(file.path, ())}
        ):
            differs = "it is no text file" if there is None else "it differs from the proposal"
            say(f"kept       {file.path}: {differs}; --dry-run prints the proposal")
            continue
        else:
            say(f"{'renewed ' if path.exists() else 'written '}   {file.path}")
            _write(path, file.text)
        written[file.path] = _digest(file.text)
        _write_manifest(root, plan.name, written)  # after each file: a failure at the next one can be undone
    _write_manifest(root, plan.name, written)


def taken_ports(root: Path) -> dict[str, TakenPorts]:
    """Return the TCP ports of the configurations that are there, by name of the file."""
    found = {}
    for path in _under(root, "/etc/tactiled").glob("*.toml"):
        with contextlib.suppress(ConfigError, AttributeError, TypeError, ValueError):
            document = tomlfile.read(path)
            if kind_of(document) != "configuration":
                continue
            endpoints = document.get("publish", {}).get("endpoints", (DEFAULT_ENDPOINT,))
            named = re.findall(r"tcp://\S+:(\d{1,5})\b", " ".join(endpoints))
            events = {int(port) for port in named if 0 < int(port) < 2**16}
            metrics = {int(document.get("metrics", {}).get("port", 0))}
            found[path.stem] = TakenPorts(events, events | {port + 1 for port in events} | metrics)
    return found


def check_other_port(plan: SetupPlan, url: str, root: Path) -> None:
    """Refuse a name whose configuration is of another port that is there: the board behind it would lose it.

    Boards of one layout may all have one serial number, by which they are named. `ConfigError` if this is so.
    """
    try:
        port = str(tomlfile.read(_under(root, plan.files[0].path))["port"]["url"])
    except (ConfigError, KeyError, TypeError):
        return  # there is none, or none that names a port
    if Path(port).exists() and Path(port).resolve() != Path(url).resolve():
        words = f"{plan.name} is set up for {port}: give this board a name of its own"
        raise ConfigError("NAME", [f"{words}, or first run tactiled setup {plan.name} --remove"])


def written_for(name: str, root: Path) -> dict[str, str]:
    """Return the files that `write` wrote for a board, with their digests; errors as for `remove`."""
    manifest = _manifest(root, name_of(name))
    if not manifest.exists():
        known = sorted(path.name.removesuffix(".setup.json") for path in manifest.parent.glob("*.setup.json"))
        raise OperatorError(f"{name}: not set up here; set up: {', '.join(known) or 'nothing'}")
    return _read_manifest(root, name)


def remove(name: str, root: Path, say: Say) -> None:
    """Remove what `write` wrote for a board, except for files that were edited since.

    Files that all boards share go with the last board. The folder of its recordings, which its unit has made,
    goes if it is empty. `OperatorError` if the name is none, nothing was set up under it, or a file cannot be
    removed.
    """
    written = written_for(name, root)
    others = _written_for_others(root, name)
    for name_of_file, digest in sorted(written.items()):
        path = _under(root, name_of_file)
        if not path.exists():
            continue
        if name_of_file in others:
            say(f"kept       {name_of_file}: another board needs it")
        elif (there := _text_of(path)) is None or _digest(there) != digest:
            say(f"kept       {name_of_file}: it was edited")
        else:
            _unlink(path)
            say(f"removed    {name_of_file}")
    _unlink(_manifest(root, name))
    state = _under(root, f"/var/lib/tactiled/{name}")
    with contextlib.suppress(OSError):  # there is none, or one with recordings
        state.rmdir()
        state.parent.rmdir()


def run_commands(commands: Sequence[tuple[str, ...]], say: Say) -> None:
    """Run commands of the system; one that fails is reported and does not stop the others."""
    for command in commands:
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S, check=False)
            words = "" if done.returncode == 0 else f": failed: {done.stderr.strip() or done.returncode}"
        except (OSError, subprocess.TimeoutExpired) as error:
            words = f": not run: {error}"
        say(f"ran        {' '.join(command)}{words}")


def _under(root: Path, path: str) -> Path:
    return root / path.lstrip("/")


def _manifest(root: Path, name: str) -> Path:
    """Return the list of what was written for a board, from which `--remove` works."""
    return _under(root, f"/etc/tactiled/{name}.setup.json")


def _text_of(path: Path) -> str | None:
    """Text of a file; None where there is none, or none of ours: a folder, a device, other bytes."""
    try:
        return read_text(path)
    except (DataError, FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise OperatorError(f"{path}: cannot be read: {error.strerror}; run this with sudo") from None


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _read_manifest(root: Path, name: str) -> dict[str, str]:
    """Files that were written for a board, with their digests.

    `OperatorError` if the list is damaged, or names a file where `tactiled setup` writes none.
    """
    manifest = _manifest(root, name)
    if not manifest.exists():
        return {}
    try:
        found = json_of(_text_of(manifest) or "")
    except DataError:
        found = None
    if not isinstance(found, dict) or not all(_OURS.fullmatch(path) for path in found):
        raise OperatorError(
            f"{manifest}: is no list of what `tactiled setup` wrote for {name}; remove it and its files"
        )
    return {path: str(digest) for path, digest in found.items()}


def _written_for_others(root: Path, name: str) -> dict[str, set[str]]:
    """Files that were written for other boards than this one, with their digests."""
    found: dict[str, set[str]] = {}
    for path in _under(root, "/etc/tactiled").glob("*.setup.json"):
        if (other := path.name.removesuffix(".setup.json")) != name:
            for written, digest in _read_manifest(root, other).items():
                found.setdefault(written, set()).add(digest)
    return found


def _write_manifest(root: Path, name: str, written: dict[str, str]) -> None:
    _write(_manifest(root, name), json.dumps(written, indent=1, sort_keys=True) + "\n")


def _write(path: Path, text: str) -> None:
    with _needs_root(path, "written"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def _unlink(path: Path) -> None:
    with _needs_root(path, "removed"):
        path.unlink()


@contextlib.contextmanager
def _needs_root(path: Path, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OperatorError(f"{path}: cannot be {what}: {error.strerror}; run this with sudo") from None
