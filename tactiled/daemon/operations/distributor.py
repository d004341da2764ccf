"""Distribution of the events and reads of one board: to publisher, recorder and metrics."""

from collections.abc import Mapping, Sequence
from typing import Any

from tactiled.daemon.board.session import Session
from tactiled.daemon.clock import EpochClock
from tactiled.daemon.operations.metrics import Metrics
from tactiled.daemon.operations.recorder import Recorder
from tactiled.daemon.zmq.publisher import Publisher
from tactiled.events.types import Event, Sent
from tactiled.pipeline import Pipeline
from tactiled.received import Output
from tactiled.recording.contents import Read


class Distributor:
    """Send each event to publisher, recorder and metrics."""

    def __init__(
        self,
        pipeline: Pipeline,
        session: Session,
        publisher: Publisher,
        metrics: Metrics,
        clock: EpochClock,
        recorder: Recorder | None = None,
    ) -> None:
        self.metrics = metrics
        self._pipeline = pipeline
        self._session = session
        self._publisher = publisher
        self._recorder = recorder
        self._clock = clock

    @property
    def sent(self) -> Sent:
        """Numbers of messages published for this board, by topic."""
        return self._publisher.sent(self._session.board_serial)

    def publish(self, event: Event) -> None:
        """Publish an event of the pipeline; the recorder gets it through `record_read`, with its bytes."""
        self._publisher.send(event, board=self._session.board_serial, unix_offset_s=self._clock.offset_s)
        self.metrics.count(event, self._publisher.dropped[self._session.board_serial])

    def flush(self) -> None:
        """Send what was published in this turn of the event loop, ahead of its end."""
        self._publisher.server.flush()

    def publish_and_record(self, event: Event) -> None:
        """Publish and record an event that the daemon itself made."""
        self.publish(event)
        if self._recorder is not None:
            self._recorder.daemon_event(event, self._session.board_serial, self._clock.offset_s)

    def record_read(self, data: bytes, outputs: Sequence[Output], now_s: float) -> None:
        """Record a read of the port and the outputs of the pipeline for it."""
        if self._recorder is not None:
            hello, offset_s = self._pipeline.hello, self._clock.offset_s
            for index in self._pipeline.late_fits:  # before the read, so that a replay knows of them in time
                self._recorder.commanded("late-fit", {"index": index}, (), hello, now_s, offset_s)
            read = Read(now_s, offset_s, data)
            self._recorder.received(read, outputs, self._pipeline.hello)

    def disconnected(self, now_s: float) -> None:
        """Record the loss of the port."""
        if self._recorder is not None:
            self._recorder.disconnected(now_s, self._clock.offset_s, self._pipeline.hello)

    def tuned(self, name: str, arguments: Mapping[str, Any], events: Sequence[Event], now_s: float) -> None:
        """Record a command to the pipeline, and publish the events that it caused."""
        if self._recorder is not None:
            hello, offset_s = self._pipeline.hello, self._clock.offset_s
            self._recorder.commanded(name, arguments, events, hello, now_s, offset_s)
        for event in events:
            self.publish(event)

    def poll_recorder(self, now_s: float) -> None:
        """Publish the recording event when due; call it ten times a second."""
        if self._recorder is not None and (recording := self._recorder.report(now_s)) is not None:
            self.publish_and_record(recording)
