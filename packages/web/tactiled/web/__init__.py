"""Live view of boards in a browser: a process of its own that subscribes as any client does."""
