"""Types of C for hysteresis.py, which hatch_build.py compiles."""

cdef double CLOSING_PART, SURELY_OVER, _GROWN, _SURELY, _INFINITE


cdef class SlipHysteresis:
    cdef public double incipient_p, gross_p, least, ratio
    cdef public long n_closing, n_settle, n_low, n_looks
    cdef public bint is_open, is_gross

    cpdef settle(self)
    cpdef close(self)
    cpdef look(self, double p_incipient, double p_sliding, double ratio, double ratio_sd)
