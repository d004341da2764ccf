"""Time from the last byte of a scan to a subscriber, beside a C program with the same work."""
