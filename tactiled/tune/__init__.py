"""`tactiled tune`: derive slip parameters from the user's own noise and motion.

`tail`, `onset`, `hold` and `study` are numerics, `files` and `live` read recordings, `words` formats the
result.
"""
