"""`tactiled tune`: count slip reports in the user's own hold and motion, and propose setting and friction.

`hold` and `study` are numerics, `files` and `live` read recordings, `run` judges them and says the result.
"""
