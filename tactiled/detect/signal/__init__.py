"""Shared parts of detectors: contact gate, wavelet bank, quantiser, slip gate."""
