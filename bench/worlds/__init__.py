"""Random contact worlds with known truth, from generators whose physics have nothing in common."""
