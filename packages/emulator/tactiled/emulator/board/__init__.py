"""The emulated board: firmware, clock, electronics and identity."""
