"""Limit of BLAS to one thread.

A matrix product that is divided between threads is rounded in another order, so events would differ in the
last digit between hosts with different numbers of cores. More threads would not be faster: matrices of 36
channels are too small for two, and each call would wake every core.

Libraries that are loaded already are limited by a call, because a program that uses tactiled as a library has
often imported numpy before. scipy has a BLAS of its own, which is loaded later and by few verbs; a
library reads `OPENBLAS_NUM_THREADS` when it is loaded. The limit holds for the whole process, and the
variable for those that it starts. The client (`tactiled.client`) has no numerics and does not set it.
"""

import os

import numpy as np  # noqa: F401 # the call limits loaded libraries only
from threadpoolctl import threadpool_limits

_READ_WHEN_LOADED = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_thread() -> None:
    """Limit the BLAS libraries of numpy and scipy to one thread."""
    threadpool_limits(limits=1, user_api="blas")
    os.environ.update(dict.fromkeys(_READ_WHEN_LOADED, "1"))
