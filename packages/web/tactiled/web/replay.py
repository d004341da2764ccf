"""Recording in memory, from which the page fetches stretches as it plays, seeks and scrubs."""

import bisect
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tactiled.array import Array
from tactiled.board_geometry import geometry_of
from tactiled.errors import DataError
from tactiled.events.codec import to_map
from tactiled.recording.contents import RecordedEvent
from tactiled.recording.reader import Reached, in_order, read_items

# Messages as text, all in memory: three hours of 36 channels at 100 Hz. Compressed files may hold far more.
_MOST_TEXT_BYTES = 1 << 30
_THIN_S = 0.1  # interval of scans, grip and force messages in a thinned stretch


class ReplayFile:
    """Events of one recording, whose parts are given in any order, sorted by instant.

    `arrays` are those that do not ship with tactiled. `DataError` where a file is no recording, has no
    events, or has more than fit into memory.
    """

    def __init__(
        self, paths: Sequence[Path], arrays: Sequence[Array] = (), reached: Reached | None = None
    ) -> None:
        parts = in_order(paths)
        self._name = ", ".join(path.name for path, _ in parts)
        recorded_array = parts[0][1].source.array
        self._rows: list[tuple[float, str, str]] = []  # instant, topic, message as JSON
        self._geometry = ""
        self._n_bytes = 0
        seqs: dict[tuple[str, str], int] = {}
        # Of the wall clock in each run, as it began: a step would part the curves
        offset_s: dict[str, float] = {}
        for number, (path, header) in enumerate(parts):
            done = number / len(parts)
            share = None if reached is None else lambda part, done=done: reached(done + part / len(parts))
            for item in read_items(path, reached=share):
                if isinstance(item, RecordedEvent):
                    unix_offset_s = offset_s.setdefault(header.run, item.unix_offset_s)
                    self._take(item, unix_offset_s, seqs, [*arrays, recorded_array])
        if not self._rows:
            raise DataError(f"{self._name}: has no events")
        if not self._geometry:  # no info was recorded
            board, array = next(iter(seqs))[0], recorded_array
            said = {"array_id": array.name, "channels": array.n_channels, "taxels": array.n_taxels}
            self._geometry = _text("geometry", {"board": board, **geometry_of(said, array)})
            first_s = min(row[0] for row in self._rows)
            zero = [] if array.zero_first_s else array.zero.tolist()
            info = {"board": board, "timestamp": first_s, **said, "zero": zero}
            self._rows.append((first_s, "info", _text("info", info)))
        self._rows.sort(key=lambda row: row[0])
        self._times = [row[0] for row in self._rows]
        self.start_s, self.end_s = self._times[0], self._times[-1]

    def _take(
        self,
        item: RecordedEvent,
        unix_offset_s: float,
        seqs: dict[tuple[str, str], int],
        arrays: Sequence[Array],
    ) -> None:
        topic, board = item.event.topic, item.board
        seqs[board, topic] = seq = seqs.get((board, topic), -1) + 1
        data = to_map(item.event, seq=seq, board=board, unix_offset_s=unix_offset_s)
        text = _text(topic, data)
        self._n_bytes += len(text)
        if self._n_bytes > _MOST_TEXT_BYTES:
            raise DataError(
                f"{self._name}: more than {_MOST_TEXT_BYTES / 1e9:.1f} GB of messages; name fewer parts, or "
                "use `tactiled replay`"
            )
        self._rows.append((float(data["timestamp"]), topic, text))
        if topic == "info" and not self._geometry:
            known = {array.name: array for array in reversed(arrays)}
            geometry = geometry_of(data, known.get(str(data.get("array_id"))))
            self._geometry = _text("geometry", {"board": board, **geometry})

    def summary(self) -> dict[str, Any]:
        """Return the name, the first and last instant (epoch seconds), and the events to list."""
        listed = [
            {"at": instant_s - self.start_s, "topic": topic, "data": json.loads(text)[2]}
            for instant_s, topic, text in self._rows
            if topic in ("slip", "contact", "texture", "command")
        ]
        return {"name": self._name, "start": self.start_s, "end": self.end_s, "events": listed}

    def stretch(self, from_s: float, to_s: float, *, thin: bool = False) -> str:
        """Return the messages of ``from_s <= instant < to_s`` (seconds from the start) as one frame.

        A thin stretch has few scans, grip and force messages: what the timeline before an instant needs.
        """
        low = bisect.bisect_left(self._times, self.start_s + from_s)
        high = bisect.bisect_left(self._times, self.start_s + to_s)
        texts = [self._geometry]
        last_s: dict[str, float] = {}
        for instant_s, topic, text in self._rows[low:high]:
            if thin and topic in ("scan", "grip", "force", "status"):
                if instant_s - last_s.get(topic, -1.0) < _THIN_S:
                    continue
                last_s[topic] = instant_s
            texts.append(text)
        return f'{{"now":{self.start_s + to_s!r},"mono":0.0,"m":[{",".join(texts)}]}}'


def _text(topic: str, data: dict[str, Any]) -> str:
    return json.dumps([0, topic, data, False], allow_nan=False, separators=(",", ":"))
