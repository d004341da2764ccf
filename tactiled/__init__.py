"""Tactile-sensing daemon: serial taxel arrays in, slip and texture events out.

docs/architecture.md has the rooms, lowest first, and what may import what.
"""

__version__ = "0.1.0"
