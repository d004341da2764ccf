"""Service for boards: what reads ports and serves sockets in one event loop, for months."""
