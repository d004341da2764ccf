"""Checks of a configuration that need no board."""

import os
from pathlib import Path

from tactiled.config import Setup
from tactiled.daemon.zmq.params import PublishParams
from tactiled.daemon.zmq.security import KeyFolder
from tactiled.doctor.abilities import check_waves
from tactiled.doctor.finding import Finding, Severity
from tactiled.doctor.host import check_disk
from tactiled.errors import ConfigError

_RATE_HZ = 100.0  # of the published board, where the configuration leaves the rate to the board
_STARTS = "the daemon starts without recording, and records as soon as this has been corrected"


def check_files(setup: Setup, source: str) -> list[str]:
    """Return warnings on keys, record directory and setting of a configuration, which the daemon starts with.

    `ConfigError` if the daemon does not start with such keys.
    """
    record = setup.config.record
    keys = [(f"publish.{one.line}", one.verdict) for one in check_keys(setup.config.publish)]
    if faults := [line for line, verdict in keys if verdict == "fail"]:
        raise ConfigError(source, faults)
    disk = [] if record.directory is None else check_disk(record)
    detect = setup.config.detect
    return [
        *(line for line, verdict in keys if verdict == "warn"),
        *(f"record.directory: {one.words}; {_STARTS}; {one.remedy}" for one in disk if one.verdict == "fail"),
        *(f"detect.{key}: not read by setting {detect.setting}" for key in detect.unread()),
    ]


def check_keys(publish: PublishParams) -> list[Finding]:
    """Check the keys of the daemon, and list the clients that may connect; no finding without keys."""
    if publish.keys is None:
        return []
    folder = Path(publish.keys)
    make = f"make one: tactiled keys make NAME --folder {folder}"
    pair = folder / "daemon.toml"

    def found(verdict: Severity, words: str, remedy: str = "") -> list[Finding]:
        return [Finding("keys", verdict, f"{folder}: {words}", remedy)]

    try:
        if not any(publish.is_guarded(endpoint) for endpoint in (*publish.endpoints, *publish.control)):
            missing = "" if folder.is_dir() else "; no such folder"
            return found("warn", f"not used, because no endpoint can be reached from other hosts{missing}")
        if folder.exists() and not folder.is_dir():
            return found("fail", "this is a file: name a folder in publish.keys", make)
        if not folder.is_dir():
            return found("fail", "no such folder", make)
        if pair.exists() and not pair.stat().st_mode & 0o077 and not os.access(pair, os.R_OK):
            return [Finding("keys", "warn", f"{pair}: not checked: this user may not read it")]
        KeyFolder(folder).pair({})
        names = sorted(KeyFolder(folder).clients().values())
    except OSError as error:
        return found("warn", f"not checked: {error.strerror}")
    except ConfigError as error:
        return [Finding("keys", "fail", f"{error.source}: {fault}") for fault in error.faults]
    if not names:
        return found("warn", "no client may connect from another host", make)
    return found("ok", f"may connect from other hosts: {', '.join(names)}")


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
    if detect.is_packaged:
        return []
    texture = detect.texture
    return [finding.line for finding in check_waves(setup.array, texture, rate_hz, texture.speed_mm_s)]
