"""The slip detector: from scan blocks to slip events."""
