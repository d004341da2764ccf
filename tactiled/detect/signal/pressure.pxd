"""Types of C for pressure.py, which hatch_build.py compiles."""

cdef double _TO_WHOLE, _INFINITE, _ONE_SIDE
cdef long _LEAST_SIDES


cdef class Hold:
    cdef public long n_channels
    cdef public double limit, steps_per_unit
    cdef public double[::1] last

    cpdef bint take(self, long n, long first, const double[::1] readings, const unsigned char[::1] valid, double[::1] steps, unsigned char[::1] ok)


cdef class Pressure:
    cdef public long n_channels, n_taxels, n_sides
    cdef public double volts_per_step, slope_scale, set_of_load, set_per_scan
    cdef public bint is_begun, is_field
    cdef public long long[::1] own, counts
    cdef public double[::1] sign, total_weights, line, totals, set

    cpdef interrupt(self, double kept)

    cpdef take(self, long n, const double[::1] steps, const double[::1] held, const double[::1] levels, double[::1] reals, unsigned char[::1] flags)
