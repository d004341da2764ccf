"""Slip events of every setting, on worlds and on the emulator's families."""
