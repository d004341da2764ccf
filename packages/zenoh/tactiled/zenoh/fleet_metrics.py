"""Metrics page of all boards of a network, for Prometheus on the host of the list.

Metrics pages of daemons listen on loopback. What they say of freshness comes here over zenoh, with its
certificates. Metrics that the daemons' pages have, too, have the same names.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector

from tactiled.errors import UnavailableError
from tactiled.zenoh.fleet import FleetRow

_HOST = "127.0.0.1"  # as the pages of daemons
_BOARD = ("host", "board")


class FleetMetrics(Collector):
    """Metrics of the newest list."""

    def __init__(self) -> None:
        self.rows: Sequence[FleetRow] = ()

    def lose(self) -> None:
        """Tell that the network cannot be asked: no board is known to be fresh."""
        self.rows = [FleetRow(row.host, row.board, "silent") for row in self.rows]

    @contextmanager
    def serving(self, port: int) -> Iterator[int]:
        """Serve ``http://127.0.0.1:PORT/metrics`` in a thread until the end of the block; yield the port.

        Raises
        ------
        UnavailableError
            The port is in use.
        """
        registry = CollectorRegistry()
        registry.register(self)
        try:
            server, thread = start_http_server(port, _HOST, registry)
        except OSError as error:
            raise UnavailableError(f"--serve: {_HOST}:{port} cannot be had: {error.strerror}") from None
        try:
            yield int(server.server_address[1])
        finally:
            server.shutdown()
            server.server_close()
            thread.join()

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics; a number that is not known is left out."""
        state = GaugeMetricFamily("tactiled_state", "1 for the present state.", labels=(*_BOARD, "state"))
        firmware = GaugeMetricFamily("tactiled_firmware", "1 for its version.", labels=(*_BOARD, "version"))
        valid = GaugeMetricFamily(
            "tactiled_valid", "1 while the tactile data are fresh, else 0.", labels=_BOARD
        )
        age = GaugeMetricFamily("tactiled_scan_age_seconds", "Age of the newest scan.", labels=_BOARD)
        used = GaugeMetricFamily("tactiled_utilisation", "Part of the friction limit in use.", labels=_BOARD)
        loss = GaugeMetricFamily(
            "tactiled_missing_ratio", "Part of the scans that are missing.", labels=_BOARD
        )
        free = GaugeMetricFamily("tactiled_disk_free_bytes", "Free space for recordings.", labels=_BOARD)
        for row in self.rows:
            board = (row.host, row.board)
            state.add_metric((*board, row.state), 1.0)
            valid.add_metric(board, float(row.valid))
            if row.firmware:
                firmware.add_metric((*board, row.firmware), 1.0)
            for family, value, scale in (
                (age, row.age_s, 1.0),
                (used, row.utilisation, 1.0),
                (loss, row.loss_ppm, 1e-6),
                (free, row.free_mb, 1e6),
            ):
                if value >= 0:
                    family.add_metric(board, scale * value)
        yield from (state, firmware, valid, age, used, loss, free)
