"""Recording, metrics, logs and the service manager: what keeps the daemon running for months."""
