"""``tactiled setup``: find a board, write what its service needs, and undo that."""
