"""Pictures that users see: a log with its events, grooves under the array."""
