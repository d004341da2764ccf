"""Frames to scan blocks: sequence unwrapping, clock fit, validity, gaps."""
