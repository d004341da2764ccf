"""Settings of both slip detectors side by side, on random worlds and on the emulator's families."""
