"""Published events and their msgpack form; needs neither numpy nor scipy."""
