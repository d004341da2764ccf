"""The groove estimator: period and angle from phase delays between taxels in a sliding window."""
