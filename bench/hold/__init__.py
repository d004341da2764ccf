"""Drops and grip force of grasp controllers on held objects drawn at random."""
