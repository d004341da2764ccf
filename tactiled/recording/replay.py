"""`tactiled replay`: recordings run again, their events said as they were live, and compared."""

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
    say: Callable[[str], None],
    *,
    topics: Collection[str] = (),
    speed: float = 0.0,
    sleep: Callable[[float], None] = time.sleep,
    reached: Reached | None = None,
) -> ReplayComparison:
    """Run recordings again and say each event as the JSON line that `tactiled listen` printed live.

    Parameters
    ----------
    paths : sequence of Path
    say : callable
        Takes a line.
    topics : collection of str
        Only these; empty for all.
    speed : float
        1 is real time, 2 twice as fast, 0 as fast as can be.
    reached : callable, optional
        Takes the share that is done, from 0 to 1.

    Raises
    ------
    DataError
        See `Replay`.
    """
    seqs: dict[str, int] = {}
    pace = PlaybackPace(speed, sleep)
    again = Replay(paths, reached)
    verdict = ReplayVerifier(again)
    for step in again:
        if not is_damage(step.told):  # which has no instant of this clock
            pace.wait(step.time_s)
        verdict.compare(step)
        for said in step.now:
            topic = said.event.topic
            seqs[topic] = seq = seqs.get(topic, -1) + 1
            if not topics or topic in topics:
                message = to_map(said.event, seq=seq, board=said.board, unix_offset_s=said.unix_offset_s)
                say(json.dumps({"topic": topic, **message}, allow_nan=False))
    return verdict.result()
