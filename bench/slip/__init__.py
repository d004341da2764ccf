"""Slip events of every setting, on random worlds and on the emulator's families."""
