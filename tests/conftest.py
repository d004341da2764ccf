"""What all tests share: hypothesis draws the same examples on every machine, so that a change is judged by
the change. ``./run test --hypothesis-profile explore`` draws new ones.
"""

from hypothesis import settings

# How long an example takes is the machine's affair; times are measured in benchmarks.
settings.register_profile("explore", deadline=None)
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")
