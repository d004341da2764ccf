"""The serial port: opened, read, written and opened again after it was lost."""
