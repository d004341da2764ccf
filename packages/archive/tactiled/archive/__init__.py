"""Many recordings: events of all of them in one table, and copies in a store of files."""
