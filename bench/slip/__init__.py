"""Slip detection: latency, false alarms, direction."""
