"""Scan blocks to events. Pure numerics: no I/O, no clock, no wire."""
