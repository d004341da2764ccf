"""Recordings in viewers of others."""
