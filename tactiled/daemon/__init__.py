"""Service for one board: the only package with asyncio, serial ports, ZeroMQ sockets and signals."""
