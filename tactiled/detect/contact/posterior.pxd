"""Types of C for posterior.py, which hatch_build.py compiles."""

cimport cython

cdef extern from "math.h":
    cpdef double log(double x)
    cpdef double exp(double x)
    cpdef double sqrt(double x)

cdef double RIPPLE_P, FIVE_PERCENT, _LEAST_RATIO, _LEAST_VARIANCE, _HERE_SD, _RATIO_SD, _LEARNT_LOG, _LEARNT_SD, _UNTOLD, _UNTOLD_WITHOUT_ZERO
cdef double _PLAUSIBLE_SDS, _TINY


cdef class Posterior:
    cdef public long long[::1] columns
    cdef public double[::1] row, cells, shown, soon, utilisation, friction, edges, middles, shares, wanted
    cdef public double p_sliding, slipping_share

    cpdef gather(self, double[::1] signs, double[::1] memory)
    cpdef take(self, double[::1] scores, double[::1] soon_scores, double signs_odds, double ratio,
               double log_friction, double variance, int has_zero, int ripple_travels)
    cpdef publish(self, int is_gross, double least_sliding, double ratio, double log_friction, double variance)
    cdef _take_quantiles(self)
