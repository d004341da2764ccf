"""``tactiled doctor``: check a set-up and print one line per finding, with its remedy.

`finding` is the result type; `port`, `board`, `abilities` and `host` are the checks; `examine` runs them. The
board streams during its check for 2 s, and its state is restored afterwards.
"""
