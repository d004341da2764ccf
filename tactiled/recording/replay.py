"""`tactiled replay`: run recordings through the pipeline, print the events and compare them."""

import json
import time
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from tactiled.events.codec import to_map
from tactiled.recording.comparison import ReplayComparison, ReplayVerifier
from tactiled.recording.pace import PlaybackPace
from tactiled.recording.reader import Reached
from tactiled.recording.steps import Replay, is_damage


def replay(
    paths: Sequence[Path],
    write_line: Callable[[str], None],
    *,
    topics: Collection[str] = (),
    speed: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
    reached: Reached | None = None,
) -> ReplayComparison:
    """Run recordings through the pipeline and print each event as JSON, as `tactiled listen` did live.

    Parameters
    ----------
    write_line : callable
        Called with each line.
    topics : collection of str
        Topics to print; empty for all.
    speed : float
        1 is real time, 2 twice as fast, 0 as fast as possible.
    reached : callable, optional
        Called with the completed fraction, 0 to 1.

    Raises
    ------
    DataError
        See `Replay`.
    """
    seqs: dict[str, int] = {}
    pace = PlaybackPace(speed, sleep)
    replayed_run = Replay(paths, reached)
    verdict = ReplayVerifier(replayed_run)
    for step in replayed_run:
        if not is_damage(step.cause):  # a damage mark has no time on this clock
            pace.wait(step.time_s)
        verdict.compare(step)
        for replayed in step.now:
            topic = replayed.event.topic
            seqs[topic] = seq = seqs.get(topic, -1) + 1
            if not topics or topic in topics:
                message = to_map(
                    replayed.event, seq=seq, board=replayed.board, unix_offset_s=replayed.unix_offset_s
                )
                write_line(json.dumps({"topic": topic, **message}, allow_nan=False))
    return verdict.result()
