"""Types of C for memory.py, which hatch_build.py compiles."""

cdef extern from "math.h":
    cpdef double log(double x)
    cpdef double exp(double x)

cdef double _MOST_ODDS, _LEAST_ODDS, _LONG_S, _PEAK_S, _SLID_S, _BORNE_S, _LEAST_RATIO, _ONSETS, _ENDS
cdef double _FILTER_PART, _LOOK_S


cdef class Memory:
    cdef public double[::1] row, means, times_s
    cdef public double base_odds
    cdef public double largest, filtered, sliding_part, movement, slid_log, slid_s, borne, crossing_log
    cdef public double since_likely_s, before_log
    cdef public long is_likely

    cpdef take(self, double p, double ratio, double step_s, double kept)
    cdef _fill(self, double odds, double log_ratio)
