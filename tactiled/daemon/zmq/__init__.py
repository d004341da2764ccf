"""The daemon's ZeroMQ sockets: events out, requests and commands in, keys and access."""
