"""Scenes and their ground truth: what the skin touches and what happens to it."""
