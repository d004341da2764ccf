"""Contact model: how much of what friction can bear is in use, and how likely gross slip is."""
