"""Independent jobs on all cores of this host, or on a Dask cluster; results never depend on which."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import Any

from tactiled.errors import UnavailableError

# For the scheduler to answer; one in the same network does within a second.
_CONNECT_S = 10


@contextmanager
def executor(n_workers: int | None = None, dask: str | None = None) -> Iterator[Executor]:
    """Start workers, for a ``with`` block; jobs that have not begun at its end are cancelled.

    They are processes on this host, one for each core if `n_workers` is not given, or those of the Dask
    scheduler at an address such as ``tcp://10.0.0.5:8786``.

    Raises
    ------
    UnavailableError
        The scheduler does not answer.
    """
    if dask is None:
        # "spawn": a forked child would inherit locks of BLAS threads.
        pool = ProcessPoolExecutor(n_workers, get_context("spawn"), initializer=_end_with_parent)
        # All workers start before the thread that watches them. If one ended while another was being started,
        # that thread would wait for the new one without end, because it never told it to stop.
        pool._safe_to_dynamically_spawn_children = False  # type: ignore[attr-defined]  # noqa: SLF001
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)
        return
    from distributed import Client

    try:
        client: Any = Client(dask, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:  # distributed's own timeout is an OSError
        raise UnavailableError(f"no Dask scheduler answers at {dask}: {error}") from None
    with client:
        yield client.get_executor(pure=False)


def _end_with_parent() -> None:
    """End this worker when the process that started it is killed; its queue would let it wait for ever."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
