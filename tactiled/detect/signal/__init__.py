"""Shared parts of detectors: contact gate, wavelet bank, pairs of channels, quantiser, slip gate."""
