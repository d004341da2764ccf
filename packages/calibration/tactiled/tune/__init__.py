"""`tactiled tune`: count slip reports in the user's own hold and motion, and propose setting and friction.

`study` is numerics, `recordings` reads or records, `run` judges and says the result.
"""
