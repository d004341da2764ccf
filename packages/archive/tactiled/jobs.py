"""Independent jobs on all cores of this host; results never depend on how many."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context, parent_process


@contextmanager
def executor(n_workers: int | None = None) -> Iterator[Executor]:
    """Start processes, one for each core by default; jobs not begun when the block ends are cancelled."""
    # "spawn": a forked child would inherit locks of BLAS threads.
    pool = ProcessPoolExecutor(n_workers, get_context("spawn"), initializer=_end_with_parent)
    # All workers start before the thread that watches them. If one ended while another was being started,
    # that thread would wait for the new one without end, because it never told it to stop.
    pool._safe_to_dynamically_spawn_children = False  # type: ignore[attr-defined]  # noqa: SLF001
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """End this worker when the process that started it is killed; its queue would let it wait for ever."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
