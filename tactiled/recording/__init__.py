"""Raw bytes and arrival times to disk and back; other people's CSV and npz logs too."""
