"""Session with the board: commands and answers, state, diagnosis of the line, status events."""
