"""`tactiled tune`: the user's own noise and motion, and the slip parameters that follow from them.

`tail`, `onset`, `hold` and `study` are numerics, `files` and `live` fetch recordings, `words` says what came
of them.
"""
