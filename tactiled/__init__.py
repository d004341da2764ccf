"""Tactile-sensing daemon: serial taxel arrays in, slip and texture events out.

The rooms, lowest first, and what may import what, are drawn in README.md.
"""

__version__ = "0.1.0"
