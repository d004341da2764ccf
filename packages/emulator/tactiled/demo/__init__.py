"""``tactiled demo``: run emulator, daemon and subscriber as processes and compare with the truth."""

from tactiled.demo.play import DemoError, run_demo

__all__ = ["DemoError", "run_demo"]
