"""Types of C for posterior.py, which hatch_build.py compiles."""

cdef extern from "math.h":
    cpdef double log(double x)
    cpdef double exp(double x)
    cpdef double sqrt(double x)

cdef double CONTACT_LOG_SD, FRICTION_LOG_SD, SURELY_OVER, RIPPLE_P, FIVE_PERCENT, LEAST_BORNE
cdef double _LEAST_VARIANCE, _PLAUSIBLE_SDS, _LOG_FRICTION, _ASTRAY, _ASTRAY_LOG_SD, _NEVER, _WITHOUT_ZERO, _AVERAGE_S


cdef class Posterior:
    cdef public double[::1] cells, logs, shown, edges, middles, shares
    cdef public tuple soon, utilisation, friction
    cdef public double new_part, p_sliding, slipping_share, p_sliding_now, p_incipient
    cdef public bint is_begun, is_gross

    cpdef begin(self)
    cpdef take(self, double[::1] scores, double[::1] soon_scores, double signs_odds, double ratio,
               double log_friction, double variance, bint was_seen, bint ripple_travels)
    cpdef publish(self, bint is_gross, double least_sliding, double ratio, double log_friction, double variance)
    cdef double _quantile(self, double wanted)
