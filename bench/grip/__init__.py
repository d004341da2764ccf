"""Scores of the contact model on worlds."""
