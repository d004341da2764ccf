"""What several tests of recordings measure."""

import tracemalloc
from collections.abc import Callable, Iterator

import pytest


@pytest.fixture
def memory() -> Iterator[Callable[[], int]]:
    """Peak of allocated bytes since the beginning of the test."""
    tracemalloc.start()
    yield lambda: tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
