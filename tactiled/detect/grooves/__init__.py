"""The joint groove estimator: period and angle from the phases of all channels in one window."""
