"""Recordings of sensors that are not ours: what a user's array file and `tactiled detect` make of them."""
