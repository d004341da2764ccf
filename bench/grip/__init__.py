"""Scores of the contact model on random worlds."""
