"""Counters, buckets and lines of the clock, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import fastest
from tactiled.samples.bucket import Bucket
from tactiled.samples.envelope import Lines, lines_through
from tactiled.samples.unwrap import ScanCounter

__all__ = ["Bucket", "Lines", "ScanCounter", "lines_through"]

if not TYPE_CHECKING:
    globals().update({name: fastest(globals()[name]) for name in __all__})
