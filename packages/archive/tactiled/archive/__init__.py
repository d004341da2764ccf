"""Many recordings: events of all of them in one table."""
