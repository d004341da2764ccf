"""Types of C for friction.py, which hatch_build.py compiles."""

cdef extern from "math.h":
    cpdef double log(double x)

cdef double LEAST_RATIO, CONTACT_LOG_SD, _SLIDE_SD, _SLIDE_S, _WALK_SD, _LEAST_SD


cdef class FrictionMemory:
    cdef public double log_mean, variance, contact_log_mean, contact_variance, most_variance

    cpdef begin_contact(self)
    cpdef widen(self, double log_sd)
    cpdef walk(self, double time_s)
    cpdef learn(self, double p_sliding, double ratio, double kept, double step_s)
