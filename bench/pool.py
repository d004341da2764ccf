"""Worker processes of the benches that take long; what they find does not depend on how many there are."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

_WORKERS = 2  # measured times are of a two-core machine


def workers() -> ProcessPoolExecutor:
    """Pool of processes, for a `with` block."""
    return ProcessPoolExecutor(_WORKERS, mp_context=get_context("spawn"))
