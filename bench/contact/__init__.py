"""The contact models of the emulator against finite elements."""
