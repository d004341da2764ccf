"""``tactiled doctor``: what is right and what is wrong with a set-up, and what to do, a line for each.

`finding` is what a check says, `port`, `board`, `resolving` and `host` are the checks, `examine` puts them
together. Nothing is changed but for the seconds that the board is listened to: it is left as it was found.
"""
