"""Slip detectors on physical scenes: latency, false alarms, cost."""
