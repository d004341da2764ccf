"""The published procedures (Wang, Chen and Mei 2019): slip rule and groove measurement."""
