"""``tactiled demo``: the whole path as real processes, and a verdict."""

from tactiled.demo.play import DemoError, run_demo

__all__ = ["DemoError", "run_demo"]
