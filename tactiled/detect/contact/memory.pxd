"""Types of C for memory.py, which hatch_build.py compiles."""

cdef extern from "math.h":
    cpdef double log(double x)
    cpdef double exp(double x)

cdef double LEAST_RATIO, LOOK_S
cdef double _MOST_ODDS, _LEAST_ODDS, _LONG_S, _PEAK_S, _BORNE_S, _ONSETS, _ENDS, _FILTER_PART, _MOST_UNLOADED

cpdef double kept_load(double log_load_change)


cdef class Memory:
    cdef public double[::1] row, times_s
    cdef public double base_odds, largest, filtered, sliding_part, movement, slid_log, slid_s, borne
    cdef public double crossing_log, since_likely_s, before_log
    cdef public bint is_likely

    cpdef begin_contact(self)
    cpdef take(self, double p, double ratio, double step_s, double kept)
