"""Calibration rig: a drawn sensor is pressed, and a force sensor with its own clock measures beside it."""
