"""Recordings: raw bytes, arrival times and events in MCAP files, and logs in CSV or npz format."""
