"""Worker processes of the benches that take long; what they find does not depend on how many there are."""

import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

_WORKERS = 2  # measured times are of a two-core machine
_THREADS = "OPENBLAS_NUM_THREADS"


@contextmanager
def workers() -> Iterator[ProcessPoolExecutor]:
    """Pool of processes of one thread each: matrices of 36 channels do not fill two."""
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = "1"
    try:
        with ProcessPoolExecutor(_WORKERS, mp_context=get_context("spawn")) as pool:
            yield pool
    finally:
        if before is None:
            del os.environ[_THREADS]
        else:
            os.environ[_THREADS] = before
