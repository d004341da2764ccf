"""Trees that learn the signs of sliding on several generators of worlds, a reference for the model."""
