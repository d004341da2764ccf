"""The published experiments, played by the emulator."""
