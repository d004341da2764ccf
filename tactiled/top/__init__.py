"""Live view of boards in a terminal, for work over ssh; a client like any other.

Drawn with rich, which tactiled needs anyway for its progress bars; textual would add a framework and a second
event loop for one screen without widgets.
"""
