"""What there is to say of slips while a scene is played."""

from collections.abc import Callable, Iterator
from typing import Any

from tactiled.emulator.scene.slip_instants import SlipWatch
from tactiled.emulator.scene.truth import Truth, plain_slip


class SlipNews:
    """Each slip when it becomes gross, and again when it has ended.

    Parameters
    ----------
    watch : SlipWatch
    """

    def __init__(self, watch: SlipWatch) -> None:
        self._watch = watch
        self._number = 0  # of the slip that may have news
        self._said_gross = False

    def since_last(self, truth: Callable[[], Truth]) -> Iterator[dict[str, Any]]:
        """Slips as plain data, with their ``number``; `truth` is asked only where there is news."""
        while self._number < self._watch.count:
            back = self._number - self._watch.count
            slip = self._watch.episodes[back]
            ended = slip.end_s is not None
            if ended or (slip.gross_s is not None and not self._said_gross):
                yield {"number": self._number, **plain_slip(truth().episodes[back])}
                self._said_gross = True
            if not ended:
                return
            self._number, self._said_gross = self._number + 1, False
