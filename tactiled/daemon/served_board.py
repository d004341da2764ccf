"""Parameters of the daemon, and the boards that one process serves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from tactiled.daemon.board.requirements import SessionParams
from tactiled.daemon.operations.exporter import MetricsParams
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.zmq.publisher import PublishParams
from tactiled.pipeline import Pipeline
from tactiled.tomlfile import Params


class ServiceParams(Params):
    """Parameters of the daemon for one board; boards of one process share `metrics`."""

    port: PortParams
    session: SessionParams = SessionParams()
    publish: PublishParams = PublishParams()
    metrics: MetricsParams = MetricsParams()

    def without_publishing(self) -> Self:
        """Return a copy without endpoints, for a program that only records."""
        return self.model_copy(update={"publish": PublishParams(endpoints=())})


@dataclass(frozen=True)
class ServedBoard:
    """Board that a service reads.

    Attributes
    ----------
    make_pipeline : callable
        Returns a pipeline in its initial state; called at the start, and again after a fault of tactiled.
    recorder : Recorder, optional
        Takes every read of the port with its outputs, and all events that the daemon itself makes.
    reload : callable, optional
        Reads the configuration again (SIGHUP) and returns its parameters.
    """

    params: ServiceParams
    make_pipeline: Callable[[], Pipeline]
    recorder: Recorder | None = None
    reload: Callable[[], ServiceParams] | None = None
