"""What every detector builds on: contact gate, wavelet bank, pairs of channels, quantiser, slip gate."""
