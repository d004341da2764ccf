"""``./run bench machine``: a whole Debian in qemu with the Debian package, USB adapters and power cuts."""
