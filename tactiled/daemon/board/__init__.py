"""The conversation with the board, and what is known of the board and its line."""
