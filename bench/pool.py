"""Worker processes of the long benches; results do not depend on their number."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

_WORKERS = 2  # measured times are of a two-core machine


def workers() -> ProcessPoolExecutor:
    """Pool of processes, for a `with` block."""
    return ProcessPoolExecutor(_WORKERS, mp_context=get_context("spawn"))
