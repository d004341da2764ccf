"""Alerts for Prometheus: by promtool on made courses, and by a real Prometheus that watches a real daemon."""

import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pages import CONFIG, robot
from patience import PATIENCE_S
from routers import free_port

from tactiled.resources import shipped

ALERTS = shipped("config", "viewers", "prometheus-alerts.yml")
COURSES = Path(__file__).with_name("alerts_test.yml")
PROMETHEUS = """\
global: {{ scrape_interval: 1s, evaluation_interval: 1s }}
rule_files: ["{alerts}"]
scrape_configs:
  - job_name: tactiled
    static_configs: [{{ targets: ["127.0.0.1:{metrics}"] }}]
"""


def need(program: str) -> None:
    if shutil.which(program) is None and "TACTILED_CI" not in os.environ:
        pytest.skip(f"needs {program}: sudo apt install prometheus")


def test_promtool_finds_no_fault(tmp_path: Path) -> None:
    need("promtool")
    subprocess.run(["promtool", "check", "rules", ALERTS], check=True)
    shutil.copy(ALERTS, tmp_path)
    shutil.copy(COURSES, tmp_path)
    done = subprocess.run(
        ["promtool", "test", "rules", COURSES.name], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@contextmanager
def prometheus(folder: Path, metrics_port: int) -> Iterator[str]:
    """Prometheus that watches a metrics page; its address."""
    config, address = folder / "prometheus.yml", f"127.0.0.1:{free_port()}"
    config.write_text(PROMETHEUS.format(alerts=ALERTS, metrics=metrics_port))
    options = f"--storage.tsdb.path={folder / 'series'}", f"--web.listen-address={address}"
    with (folder / "prometheus.log").open("wb") as log:
        process = subprocess.Popen(
            ["prometheus", f"--config.file={config}", *options], stdout=log, stderr=log
        )
    try:
        yield f"http://{address}"
    finally:
        process.kill()
        process.wait()


def firing(address: str) -> set[tuple[str, str]]:
    """Alerts that fire, with their boards."""
    try:
        with urllib.request.urlopen(f"{address}/api/v1/alerts") as answer:
            alerts: list[dict[str, Any]] = json.load(answer)["data"]["alerts"]
    except OSError:  # it starts
        return set()
    return {
        (alert["labels"]["alertname"], alert["labels"].get("board", ""))
        for alert in alerts
        if alert["state"] == "firing"
    }


def answers(address: str, query: str) -> list[str]:
    """Values of a metric, one for each board."""
    try:
        with urllib.request.urlopen(f"{address}/api/v1/query?query={query}") as answer:
            return [one["value"][1] for one in json.load(answer)["data"]["result"]]
    except OSError:  # it starts
        return []


def until(is_so: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < until_s
        time.sleep(0.2)


@pytest.mark.system
def test_prometheus_tells_of_a_board_that_is_unplugged(tmp_path: Path) -> None:
    need("prometheus")
    port = free_port()
    with (
        robot(tmp_path, f"{CONFIG}[metrics]\nport = {port}\n") as made,
        prometheus(tmp_path, port) as address,
    ):
        made.run()
        made.plug()
        until(lambda: answers(address, "tactiled_valid") == ["1"])
        assert firing(address) == set()
        made.stop("board")
        until(lambda: ("TactiledNotFresh", "TS0001") in firing(address))
        made.stop("daemon")
        until(lambda: answers(address, "up") == ["0"])
