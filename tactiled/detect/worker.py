"""Computations that a detector hands over, and takes back at a scan that is fixed beforehand.

A groove fit takes as long as several scans. Live it runs beside the event loop; offline and in a replay it is
computed in place. Because the result is used at the same scan everywhere, the events are the same everywhere.
"""

from collections.abc import Callable
from contextvars import ContextVar
from typing import Generic, Protocol, TypeVar

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

_pause: ContextVar[Callable[[], None] | None] = ContextVar("pause", default=None)


def pause() -> None:
    """Let other threads run; called by long computations between small steps.

    Small-array numpy keeps the interpreter lock, and another thread that wants it waits up to 5 ms.
    Operations on large arrays release it by themselves. Does nothing in a thread that has not called
    `set_pause`.
    """
    if (action := _pause.get()) is not None:
        action()


def set_pause(action: Callable[[], None]) -> None:
    """Set what `pause` does in the calling thread; an exception that it raises ends the computation."""
    _pause.set(action)


class Job(Protocol[T_co]):
    """A computation that was handed over."""

    def result(self) -> T_co | None:
        """Return the result, or None where it is not ready; it is then given up."""
        ...


class Worker(Protocol):
    """Something that computes jobs."""

    def submit(self, work: Callable[[], T]) -> Job[T]:
        """Hand over a computation that depends on nothing that changes."""
        ...


class _Deferred(Generic[T]):
    """Job that is computed when its result is taken."""

    def __init__(self, work: Callable[[], T]) -> None:
        self._work = work

    def result(self) -> T:
        """Compute and return the result."""
        return self._work()


class InPlace:
    """Worker of offline analysis and replay: computes in the calling thread, and is never late."""

    def submit(self, work: Callable[[], T]) -> Job[T]:
        """Keep a computation until its result is taken."""
        return _Deferred(work)
