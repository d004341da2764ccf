"""BLAS on one thread.

A matrix product that is divided between threads is rounded in another order, and events would differ in the
last digit from one number of cores to another. More threads gain nothing either: matrices of 36 channels do
not fill two, and each call would wake every core.

The limit is set by a call and not by `OPENBLAS_NUM_THREADS`, which a library reads once, when it is loaded: a
program that uses tactiled as a library has often imported numpy before. The limit holds for the process. The
client (`tactiled.client`) has no numerics and leaves the threads of its program alone.
"""

import scipy.linalg  # noqa: F401  scipy has a BLAS of its own beside numpy's, and only what is loaded is limited
from threadpoolctl import threadpool_limits


def use_one_thread() -> None:
    """Limit the BLAS libraries of numpy and scipy to one thread."""
    threadpool_limits(limits=1, user_api="blas")
