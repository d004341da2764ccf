"""Latency and cost of the client of C++, beside a bare `zmq_recv`."""
