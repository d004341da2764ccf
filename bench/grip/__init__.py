"""Worlds drawn at random, model included, and scores of the contact model on them."""
