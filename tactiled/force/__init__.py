"""Readings to newtons: calibration file, model, zero, and one force event for each scan."""
