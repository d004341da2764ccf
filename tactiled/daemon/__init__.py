"""The only room with asyncio, serial ports, ZeroMQ sockets and signals: the science knows none of them."""
