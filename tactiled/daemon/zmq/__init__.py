"""ZeroMQ sockets of the daemon: events, requests and commands, keys and access control."""
