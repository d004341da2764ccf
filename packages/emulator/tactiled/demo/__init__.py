"""``tactiled demo``: run emulator, daemon and subscriber as processes and compare with the truth."""
