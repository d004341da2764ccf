"""Groove estimation against the Cramer-Rao bound."""
