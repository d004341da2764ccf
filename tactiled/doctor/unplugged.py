"""Checks of a configuration that need no board, for `check-config`."""

import os
from collections.abc import Sequence
from pathlib import Path

from tactiled.config import Setup
from tactiled.daemon.zmq.endpoints import RUNTIME
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.security import KeyFolder
from tactiled.doctor.abilities import check_waves
from tactiled.doctor.finding import Finding
from tactiled.doctor.host import check_disk
from tactiled.errors import ConfigError

_RATE_HZ = 100.0  # of the published board, where the configuration leaves the rate to the board
_VOLATILE = "/run"  # empty at each start of the host
_STARTS = "the daemon starts without recording, and records as soon as this has been corrected"


def check_files(setup: Setup, source: str) -> list[str]:
    """Check the keys, the folders of sockets and the record directory that a configuration names.

    Returns
    -------
    list of str
        Warnings: the daemon starts in spite of them.

    Raises
    ------
    ConfigError
        The daemon does not start with such keys or sockets.
    """
    publish, record = setup.config.publish, setup.config.record
    of_keys = _check_keys(publish) if publish.keys is not None else ([], [])
    of_sockets = _check_sockets((*publish.endpoints, *publish.control))
    faults, warnings = (
        [f"publish.keys: {words}" for words in keys] + [f"publish.endpoints: {words}" for words in sockets]
        for keys, sockets in zip(of_keys, of_sockets, strict=True)
    )
    if faults:
        raise ConfigError(source, faults)
    if record.directory is not None:
        for finding in check_disk(record):
            if finding.verdict == "fail":
                warnings.append(f"record.directory: {finding.words}; {_STARTS}; {finding.remedy}")
    return warnings


def _check_sockets(endpoints: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return faults of the places of ipc sockets, with which the daemon does not start, and warnings."""
    faults: list[str] = []
    warnings: list[str] = []
    remedy = f"name another, or use ipc://{RUNTIME}/events.ipc"
    for endpoint in endpoints:
        if not endpoint.startswith("ipc://") or RUNTIME in endpoint:
            continue
        path = Path(endpoint.removeprefix("ipc://"))
        folder = path.absolute().parent
        try:
            if path.exists() and not path.is_socket():
                faults.append(f"{path}: something stands there that is no socket; {remedy}")
            elif folder == Path("/"):
                faults.append(f"{path}: only root may make a socket in the root folder; {remedy}")
            elif folder.is_dir():
                if not os.access(folder, os.W_OK | os.X_OK):
                    warnings.append(f"{folder}: this user may not make a socket there")
            elif folder.is_relative_to(_VOLATILE):  # the unit, or another one, may make it at its start
                words = "no such folder: the daemon ends with status 1, and systemd starts it again"
                warnings.append(f"{folder}: {words}; make it, or use ipc://{RUNTIME}/events.ipc")
            else:
                faults.append(f"{folder}: no such folder; make it, or use ipc://{RUNTIME}/events.ipc")
        except OSError as error:
            warnings.append(f"{folder}: not checked: {error.strerror}")
    return list(dict.fromkeys(faults)), list(dict.fromkeys(warnings))


def _check_keys(publish: PublishParams) -> tuple[list[str], list[str]]:
    """Return faults with which the daemon does not start, and warnings."""
    folder = Path(publish.keys or "")
    if not any(publish.is_guarded(endpoint) for endpoint in (*publish.endpoints, *publish.control)):
        words = f"{folder}: not used, because no endpoint can be reached from other hosts"
        return [], [words if folder.is_dir() else f"{words}; no such folder"]
    make = f"make one: tactiled keys make NAME --folder {folder}"
    pair = folder / "daemon.toml"
    try:
        if folder.exists() and not folder.is_dir():
            return [f"{folder}: this is a file: name a folder in publish.keys, and {make}"], []
        if not folder.is_dir():
            return [f"{folder}: no such folder; {make}"], []
        if pair.exists() and not pair.stat().st_mode & 0o077 and not os.access(pair, os.R_OK):
            return [], [f"{pair}: not checked: this user may not read it"]
        KeyFolder(folder).pair({})
    except OSError as error:
        return [], [f"{folder}: not checked: {error.strerror}"]
    except ConfigError as error:
        return [f"{error.source}: {fault}" for fault in error.faults], []
    if not KeyFolder(folder).clients():
        return [], [f"{folder}: no client may connect from another host; {make}"]
    return [], []


def settings_in_words(setup: Setup) -> list[str]:
    """Describe what a configuration connects: port, detectors, endpoints and recordings."""
    config = setup.config
    record = config.record.directory
    return [
        f"port: {config.port.url}",
        f"events: setting {config.detect.setting}, at {', '.join(config.publish.endpoints)}",
        f"recordings: {'none' if record is None else f'in {record}'}",
    ]


def resolved_in_words(setup: Setup) -> list[str]:
    """Describe the grooves that the estimator resolves, at the configured speed or, without one, at any."""
    detect, rate_hz = setup.config.detect, setup.config.session.rate_hz or _RATE_HZ
    if detect.setting == "wang2019":
        return []
    texture = detect.texture
    return [_line(finding) for finding in check_waves(setup.array, texture, rate_hz, texture.speed_mm_s)]


def _line(finding: Finding) -> str:
    remedy = f" -> {finding.remedy}" if finding.remedy else ""
    return f"{finding.check}: {finding.words}{remedy}"
