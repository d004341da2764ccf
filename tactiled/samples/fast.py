"""Counters, buckets and lines of the clock, compiled where the installation has a compiler."""

from typing import TYPE_CHECKING

from tactiled.compiled import compiled_module
from tactiled.samples.bucket import Bucket
from tactiled.samples.envelope import Lines, lines_through
from tactiled.samples.unwrap import ScanCounter

__all__ = ["Bucket", "Lines", "ScanCounter", "lines_through"]

if not TYPE_CHECKING:
    if (_found := compiled_module("tactiled.samples.bucket")) is not None:
        Bucket = _found.Bucket
    if (_found := compiled_module("tactiled.samples.envelope")) is not None:
        Lines, lines_through = _found.Lines, _found.lines_through
    if (_found := compiled_module("tactiled.samples.unwrap")) is not None:
        ScanCounter = _found.ScanCounter
