"""Pictures that users see: a log with its events, grooves under the array."""

PICTURES = (".png", ".pdf", ".svg")
"""Endings of the files that can be drawn."""
