"""Cost and delays of the live page, measured in a browser."""
