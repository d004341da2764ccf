"""The vocabulary that tactiled speaks to the world, and its msgpack form. Needs no scipy."""
