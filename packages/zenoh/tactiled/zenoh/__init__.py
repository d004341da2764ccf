"""Bridge from a daemon to a zenoh network, for many robots; a client of the daemon like any other.

`session` and `transport` serve ``zenoh://`` endpoints of clients, `bridge` forwards, `relay` hands requests
to the daemon, `safety` refuses configurations that other hosts could reach without certificates, `fleet`
lists the boards of a network.
"""
