"""Cost and delay of the live page in a real browser."""
