"""Random scenes: each is a function of a seed, with the same scenes on any machine."""
