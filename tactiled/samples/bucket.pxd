"""Types of C for bucket.py, which hatch_build.py compiles."""


cdef class Bucket:
    cdef public double _width_s, newest_s, doubt_s, _earliest_s, _earliest_at_s
    cdef public long number, _slot, _n, _n_at_band
    cdef public list _kept
    cdef public object _answer, _band

    cpdef add(self, double board_s, double delay_s, double waited_s, bint is_whole, double latest_delay_s)
