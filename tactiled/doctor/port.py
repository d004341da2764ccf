"""Checks of the closed port: existence, permission, stable name, latency timer."""

import os
from pathlib import Path

from tactiled.daemon.serial import device
from tactiled.daemon.serial.port import check_url
from tactiled.doctor.finding import Finding, split
from tactiled.errors import ConfigError


def check_port(url: str) -> list[Finding]:
    """Check a port without opening it."""
    try:
        check_url(url)
    except ConfigError as error:
        return [split("port", error.faults[0], "fail")]
    if device.is_url(url):
        return [Finding("port", "ok", f"{url}: reached over a network or a bridge")]
    path = Path(url)
    others = device.available().replace("; ", " (", 1) + ")"
    if not path.exists():
        remedy = f"plug the board in, or correct port.url{others}"
        return [Finding("port", "fail", f"{url}: no such port", remedy)]
    if not path.is_char_device():
        return [Finding("port", "fail", f"{url}: not a serial port", f"correct port.url{others}")]
    node = path.resolve()
    there = Finding("port", "ok", f"{url} is {node}" if str(node) != url else f"{url} is there")
    return [there, _permission(url), _name(url), _latency(url)]


def _permission(url: str) -> Finding:
    if os.access(url, os.R_OK | os.W_OK):
        return Finding("permission", "ok", "this user may read and write the port")
    return Finding("permission", "fail", "this user may not read and write it", device.permission(url))


def _name(url: str) -> Finding:
    stable = device.stable_name(url)
    if stable is None or str(stable) == url or Path(url).is_symlink():
        return Finding("name", "ok", f"{url} is a stable name, or has none in /dev/serial/by-id")
    words = f"{url} can change when devices are plugged in"
    return Finding("name", "warn", words, f'set port.url = "{stable}"')


def _latency(url: str) -> Finding:
    timer_ms = device.latency_ms(url)
    if line := device.latency_warning(url, timer_ms):
        words, _, remedy = line.partition(": ")
        return Finding("latency timer", "warn", words, remedy)
    return Finding("latency timer", "ok", "the adapter has none" if timer_ms is None else f"{timer_ms} ms")
