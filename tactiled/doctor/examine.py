"""Sequence of all checks of `tactiled doctor`."""

from pathlib import Path

from tactiled import tomlfile
from tactiled.config import Setup, default_config, load_config
from tactiled.doctor.abilities import abilities
from tactiled.doctor.board import check_board
from tactiled.doctor.finding import Finding
from tactiled.doctor.host import check_daemon, check_disk, check_endpoints, running_daemon
from tactiled.doctor.port import check_port
from tactiled.doctor.unplugged import check_keys
from tactiled.errors import ConfigError


def examine(config: Path | None, port: str | None, speed_mm_s: float = 0.0) -> list[Finding]:
    """Run all checks; with an invalid configuration, check only the port."""
    try:
        setup = default_config(port or "") if config is None else load_config(config, port)
    except ConfigError as error:
        broken = [Finding("configuration", "fail", f"{error.source}: {fault}") for fault in error.faults]
        words = "board, array, endpoints, keys and disk were not checked because the configuration is invalid"
        broken.append(Finding("the rest", "warn", words, "correct the configuration, then run doctor again"))
        url = port or _named_port(config)
        return [*broken, *(check_port(url) if url else [])]
    source = str(config) if config is not None else "defaults"
    rest = _with_setup(setup, speed_mm_s, is_configured=config is not None)
    return [Finding("configuration", "ok", f"{source}: valid"), *rest]


def _with_setup(setup: Setup, speed_mm_s: float, *, is_configured: bool) -> list[Finding]:
    publish, detect = setup.config.publish, setup.config.detect
    board_serial = setup.config.session.board_serial
    findings = check_port(setup.config.port.url)
    may_open = not any(finding.verdict == "fail" for finding in findings)
    rate_hz = setup.config.session.rate_hz or 0.0
    is_running = False
    if (status := running_daemon(publish, board_serial)) is not None:
        daemon, is_running = check_daemon(status, setup.config.port.url, is_configured=is_configured)
        findings.append(daemon)
    if may_open and not is_running:
        board, board_hz = check_board(setup)
        findings += board
        rate_hz = rate_hz or board_hz
    if not detect.is_packaged:
        speed_mm_s = speed_mm_s or detect.texture.speed_mm_s
        findings += abilities(setup.array, detect.texture, rate_hz or 100.0, speed_mm_s)
    findings += check_endpoints(publish, is_running, is_configured=is_configured)
    findings += check_keys(publish)
    return [*findings, *check_disk(setup.config.record)]


def _named_port(config: Path | None) -> str:
    """Port named by a configuration that may be invalid otherwise; "" when it names none."""
    try:
        table = tomlfile.read(config)["port"] if config is not None else {}
    except (ConfigError, KeyError):
        return ""
    url = table.get("url") if isinstance(table, dict) else None
    return url if isinstance(url, str) else ""
