"""Metrics as Prometheus' own parser reads them; a port that slow, greedy and hostile clients cannot hurt."""

import asyncio
import itertools
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from boards import LAYOUT, PtyBoard
from daemons import ARRAY, Daemon, play
from hypothesis import given
from hypothesis import strategies as st
from patience import PATIENCE_S
from ports import free_pair
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families

from tactiled import compiled
from tactiled.daemon.operations import exporter as exporter_module
from tactiled.daemon.operations.exporter import Exporter, MetricsParams
from tactiled.daemon.operations.metrics import METRICS, Histogram, Metrics, metrics_text
from tactiled.daemon.serial.device import LineErrors
from tactiled.daemon.service import Service
from tactiled.events.types import RecordingEvent, SlipEvent
from tactiled.pipeline import Pipeline


def parse(text: str) -> dict[str, Metric]:
    return {family.name: family for family in text_string_to_metric_families(text)}


def value(families: dict[str, Metric], name: str, **labels: str) -> float:
    (sample,) = [
        s
        for family in families.values()
        for s in family.samples
        if s.name == name and s.labels == {"board": "TS0001", **labels}
    ]
    return float(sample.value)


@asynccontextmanager
async def connected(port: int) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        yield reader, writer
    finally:
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()


async def scrape(port: int, request: bytes = b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n") -> tuple[str, str]:
    async with connected(port) as (reader, writer):
        writer.write(request)
        answer = await reader.read()
    head, _, body = answer.decode().partition("\r\n\r\n")
    return head, body


def labels_of(families: dict[str, Metric]) -> dict[str, set[str]]:
    """Labels of all samples of each metric that are not of every metric."""
    return {
        family.name.removeprefix("tactiled_") + "_total" * (family.type == "counter"): {
            label for sample in family.samples for label in sample.labels if label not in ("board", "le")
        }
        for family in families.values()
    }


def test_a_daemon_with_a_board_is_scraped(tmp_path: Path) -> None:
    port = free_pair()
    daemon = Daemon(tmp_path)
    daemon.params = daemon.params.model_copy(update={"metrics": MetricsParams(port=port)})
    scraped: list[tuple[str, str]] = []

    async def story(_: Service) -> None:
        await daemon.until_state("running")
        await daemon.until_scans(20)
        await daemon.until(lambda: daemon.status["valid"], "a valid status")
        scraped.append(await scrape(port))

    with PtyBoard(daemon.link):
        play(daemon, story)
    head, body = scraped[0]
    assert head.startswith("HTTP/1.0 200 OK")
    assert "text/plain; version=0.0.4" in head
    families = parse(body)
    status = daemon.status
    assert 0 < value(families, "tactiled_scans_total", result="received") <= status["scans"]
    assert value(families, "tactiled_scans_total", result="missing") == 0
    assert value(families, "tactiled_frames_total", result="good") > 20
    assert value(families, "tactiled_state", state="running") == 1
    assert value(families, "tactiled_state", state="stalled") == 0
    assert value(families, "tactiled_valid") == 1
    assert value(families, "tactiled_scan_rate_hertz") == 100
    count = value(families, "tactiled_scan_latency_seconds_count")
    assert count == value(families, "tactiled_scan_latency_seconds_bucket", le="+Inf") >= 20
    described = {name: set(metric.labels) for name, metric in METRICS.items()}
    assert labels_of(families).items() <= described.items()
    of_uarts_and_disks = described.keys() - labels_of(families)
    assert all(name.startswith(("uart", "record", "disk", "reads")) for name in of_uarts_and_disks)


def bare(errors: LineErrors | None = None) -> Metrics:
    return Metrics(Pipeline(LAYOUT, ARRAY).health, lambda: errors, lambda: "TS0001")


def test_the_version_has_the_path_of_a_scan_as_a_label() -> None:
    assert f'scan_path="{compiled.path_words()}"' in metrics_text([])


def test_metrics_are_valid_before_the_first_event() -> None:
    families = parse(metrics_text([bare()]))
    assert value(families, "tactiled_frames_total", result="good") == 0
    assert "tactiled_state" not in families
    assert "tactiled_uart_errors" not in families


def test_uart_and_disk_metrics_appear_where_known() -> None:
    metrics = bare(LineErrors(framing=3, overrun=4))
    metrics.count(
        RecordingEvent(
            time_s=0.0, state="recording", reason="", file="x", parts=1, bytes_written=5,
            free_mb=2.5, reads_dropped=6, reads_waiting=7,
        ),
        8,
    )  # fmt: skip
    families = parse(metrics_text([metrics]))
    assert value(families, "tactiled_uart_errors_total", kind="framing") == 3
    assert value(families, "tactiled_uart_errors_total", kind="overrun") == 4
    assert labels_of(families)["uart_errors_total"] == set(METRICS["uart_errors_total"].labels)
    assert value(families, "tactiled_recording") == 1
    assert value(families, "tactiled_disk_free_bytes") == 2.5e6
    assert value(families, "tactiled_reads_unrecorded_total") == 6
    assert value(families, "tactiled_messages_refused_total") == 8


def test_onsets_of_slip_are_counted_by_what_explains_them() -> None:
    metrics = bare(None)
    onset = SlipEvent(
        time_s=0.0, state="onset", kind="incipient", onset_s=0.0, onset_sd_s=0.01, direction_deg=0.0,
        direction_sd_deg=2.0, confidence=1.0, taxels=(4,), detector="test", statistic=1.0, threshold=0.5,
        valid=True, detected_s=0.0,
    )  # fmt: skip
    for event in (onset, onset, replace(onset, suppressed="inhibit"), replace(onset, state="end")):
        metrics.count(event, 0)
    families, name = parse(metrics_text([metrics])), "tactiled_slip_onsets_total"
    assert value(families, name, kind="incipient", suppressed="no") == 2
    assert value(families, name, kind="incipient", suppressed="inhibit") == 1
    assert value(families, name, kind="gross", suppressed="no") == 0


@given(st.lists(st.floats(-1, 20, allow_subnormal=False), max_size=50))
def test_a_histogram_counts_every_value_once(values: list[float]) -> None:
    bounds = (0.1, 1.0, 5.0)
    histogram = Histogram(bounds)
    for item in values:
        histogram.add(item)
    found = [(labels.get("le", ending), number) for ending, labels, number in histogram.samples()]
    expected = [(str(b), sum(v <= b for v in values)) for b in bounds]
    assert [(float(le), n) for le, n in found[:3]] == [(float(b), n) for b, n in expected]
    assert found[3] == ("+Inf", len(values))
    assert found[4][1] == pytest.approx(sum(values))
    assert found[5] == ("_count", len(values))
    assert all(a <= b for (_, a), (_, b) in itertools.pairwise(found[:4]))


async def nothing() -> None:
    """Nothing to do after a story."""


def serve(
    story: Callable[[int], Awaitable[None]],
    text: Callable[[], str] = lambda: "x 1\n",
    after: Callable[[], Awaitable[None]] = nothing,
) -> None:
    """An exporter beside a story; when it has ended, no task is left over."""

    async def main() -> None:
        port = free_pair()
        exporter = Exporter(MetricsParams(port=port), text)
        serving = asyncio.create_task(exporter.run())
        try:
            await asyncio.wait_for(story(port), PATIENCE_S)
        finally:
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)
        assert len(asyncio.all_tasks()) == 1
        await after()
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(main())


@pytest.mark.parametrize(
    ("request_line", "status"),
    [
        (b"GET /metrics?x=1 HTTP/1.0", "200"),
        (b"GET / HTTP/1.1", "404"),
        (b"POST /metrics HTTP/1.1", "405"),
        (b"\xff\xfe\x00 nonsense", "405"),
        (b"", "405"),
    ],
)
def test_every_http_request_is_answered(request_line: bytes, status: str) -> None:
    async def story(port: int) -> None:
        head, _ = await scrape(port, request_line + b"\r\nHost: x\r\n\r\n")
        assert f"HTTP/1.0 {status}" in head

    serve(story)


def test_a_request_without_end_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporter_module, "_PATIENCE_S", 0.2)

    async def story(port: int) -> None:
        for request in (b"GET /metrics HTTP/1.1\r\n", b"x" * 100_000):  # too slow; too long
            async with connected(port) as (reader, writer):
                writer.write(request)
                with pytest.raises((ConnectionError, EOFError)):
                    await reader.readexactly(1)
        monkeypatch.setattr(exporter_module, "_PATIENCE_S", PATIENCE_S)
        assert (await scrape(port))[1] == "x 1\n"

    serve(story)


def n_bytes_left(connection: socket.socket) -> int:
    """Number of bytes that can be read before the other end has closed."""
    received = 0
    with suppress(ConnectionError):
        while data := connection.recv(1 << 20):
            received += len(data)
    return received


def test_a_client_that_does_not_read_is_disconnected_without_effect_on_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(exporter_module, "_PATIENCE_S", 0.5)
    answered = 0

    def text() -> str:
        nonlocal answered
        answered += 1
        return "x" * 20_000_000

    async def story(port: int) -> None:
        served = len(asyncio.all_tasks())
        with socket.create_connection(("127.0.0.1", port)) as lazy:
            lazy.sendall(b"GET /metrics HTTP/1.0\r\n\r\n")
            while not answered:
                await asyncio.sleep(0.01)
            monkeypatch.setattr(exporter_module, "_PATIENCE_S", PATIENCE_S)  # of the next request
            _, body = await scrape(port)
            assert len(body) == 20_000_000
            while len(asyncio.all_tasks()) > served:  # until the connection was given up
                await asyncio.sleep(0.01)
            lazy.settimeout(PATIENCE_S)
            assert await asyncio.to_thread(n_bytes_left, lazy) < 20_000_000

    serve(story, text)


async def head_of_a_page(port: int) -> str:
    """Head of the first page that is served."""
    async with asyncio.timeout(PATIENCE_S):
        while True:
            with suppress(ConnectionError):
                head, _ = await scrape(port)
                if head:
                    return head
            await asyncio.sleep(0.01)


def test_excess_clients_are_refused_until_others_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporter_module, "_PATIENCE_S", PATIENCE_S)

    async def story(port: int) -> None:
        async with AsyncExitStack() as held:
            for _ in range(12):
                await held.enter_async_context(connected(port))
            with suppress(ConnectionError):
                assert await scrape(port) == ("", "")
        assert "200" in await head_of_a_page(port)

    serve(story)


def test_open_clients_do_not_hold_up_the_end() -> None:
    async def story(port: int) -> None:
        served = len(asyncio.all_tasks())
        for _ in range(3):
            _, writer = await held.enter_async_context(connected(port))
            writer.write(b"GET")
        while len(asyncio.all_tasks()) < served + 3:
            await asyncio.sleep(0)

    held = AsyncExitStack()
    serve(story, after=held.aclose)


def test_a_port_in_use_is_logged_and_ends_nothing(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
            exporter = Exporter(MetricsParams(port=port), lambda: "x 1\n")
            serving = asyncio.create_task(exporter.run())
            words = f"metrics.port: 127.0.0.1:{port} cannot be had"
            async with asyncio.timeout(PATIENCE_S):
                while words not in caplog.text:
                    await asyncio.sleep(0.01)
            assert not serving.done()  # the daemon senses without the page
            assert "(Address already in use)" in caplog.text
            assert caplog.text.count("127.0.0.1") == 1
            serving.cancel()
            await asyncio.gather(serving, return_exceptions=True)

    asyncio.run(main())
