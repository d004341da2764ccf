"""Limit of BLAS to one thread.

A matrix product that is divided between threads is rounded in another order, so events would differ in the
last digit between hosts with different numbers of cores. More threads would not be faster: matrices of 36
channels are too small for two, and each call would wake every core.

The limit is set by a call and not by `OPENBLAS_NUM_THREADS`, which a library reads once, when it is loaded: a
program that uses tactiled as a library has often imported numpy before. The limit holds for the whole
process. The client (`tactiled.client`) has no numerics and does not set it.
"""

# scipy has its own BLAS beside that of numpy, and the limit applies to loaded libraries only. The detectors
# need `scipy.special` anyway, and it loads that BLAS; `scipy.linalg` would take another 7 MB.
import scipy.special  # noqa: F401
from threadpoolctl import threadpool_limits


def use_one_thread() -> None:
    """Limit the BLAS libraries of numpy and scipy to one thread."""
    threadpool_limits(limits=1, user_api="blas")
