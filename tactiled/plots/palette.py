"""Colours of the pictures: one colour for one thing in every panel."""

TRUTH = "#1a7f37"
SLIP = "#c0392b"
GROOVES = "#6a3d9a"
SECOND_GRATING = "#b08fd8"
MARGIN = "#1f4e79"
NEUTRAL = "#777777"  # thresholds and refusals
CHANNELS = ("#1f4e79", "#e07b00", "#6aa4d8", "#2b8a8a", "#b38f00")
"""Channels of one taxel, in wire order; a panel shows at most five."""
