"""Settings and checks that hold for all tests.

Hypothesis draws the same examples on every machine, so that a failure comes from the change under test.
``./run test --hypothesis-profile explore`` draws new ones.

Tests of real processes have the mark ``system``. A test that needs a host which keeps up with real time has
the mark ``alone``, too.

A test fails when it leaves an asyncio task, a thread or a file descriptor behind. A test fails after 300 s
(``timeout`` in pyproject.toml), one that runs real processes after 600 s, and one marked
``@pytest.mark.timeout(SECONDS)`` after that.
"""

import asyncio
import gc
import multiprocessing.resource_tracker
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import settings

# Hypothesis checks no durations: they depend on the machine, and the benches measure them. Examples that
# are the same in each run find a fault once. There are 30, because a run in CI has 30 minutes; `explore`
# draws others, and more.
settings.register_profile("explore", deadline=None, max_examples=200)
settings.register_profile("same", deadline=None, derandomize=True, max_examples=30)
settings.load_profile("same")

collect_ignore = ["helpers"]  # no tests: what test modules share

_SYSTEM_TIMEOUT_S = 600
_GRACE_S = 20.0  # for threads and descriptors whose end was asked for in the test
# Made by `open_port_in_thread` for a host that may not answer. It ends with the connection attempt, which
# nobody waits for, by design.
_DETACHED_THREADS = ("open-port",)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give tests that run real processes more time than the others."""
    for item in items:
        if item.get_closest_marker("system") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(_SYSTEM_TIMEOUT_S))


def pytest_collection_finish() -> None:
    """Leave what collection made out of garbage collections: each would walk through 5,000 tests."""
    gc.freeze()


def pytest_configure() -> None:
    """Start what Python starts with the first worker process and keeps until the end.

    Processes that tests start must end at Ctrl-C, also where a script that runs the tests in the background
    has made them ignore it.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    multiprocessing.resource_tracker.ensure_running()


def _threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name not in _DETACHED_THREADS}


def _descriptors() -> set[tuple[int, str]]:
    """Open descriptors with what they lead to: a number alone is used again."""
    found = set()
    for path in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # the descriptor of the listing itself
            target = str(path.readlink())
            # pytest redirects the standard streams between tests; matplotlib keeps its fonts open.
            if int(path.name) > 2 and not target.endswith(".ttf"):
                found.add((int(path.name), target))
    return found


@pytest.fixture(autouse=True)
def leaks_nothing(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fail a test that leaves asyncio tasks, threads or file descriptors behind."""
    tasks: list[str] = []
    cancel_all = asyncio.runners._cancel_all_tasks  # type: ignore[attr-defined]  # noqa: SLF001  the only sign of them

    def note_and_cancel(loop: asyncio.AbstractEventLoop) -> None:
        """Note what the coroutine given to `asyncio.run` left, which `asyncio.run` cancels without a word."""
        tasks.extend(repr(task) for task in asyncio.all_tasks(loop))
        cancel_all(loop)

    monkeypatch.setattr(asyncio.runners, "_cancel_all_tasks", note_and_cancel)
    threads, descriptors = _threads(), _descriptors()
    yield
    end_s = time.monotonic() + _GRACE_S
    while any(left := (_threads() - threads, _descriptors() - descriptors)) and time.monotonic() < end_s:
        gc.collect()  # closes what only a cycle of references holds
        time.sleep(0.01)
    new_threads, new_descriptors = left
    leaked = [f"task {task}" for task in tasks]
    leaked += [f"thread {thread.name}" for thread in new_threads]
    leaked += [f"descriptor {number}: {target}" for number, target in sorted(new_descriptors)]
    assert not leaked, "left behind by this test:\n  " + "\n  ".join(leaked)
