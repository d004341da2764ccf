"""Types of C for unwrap.py, which hatch_build.py compiles."""

cimport cython

cdef extern from "math.h":
    cpdef double floor(double x)


cdef class ScanCounter:
    cdef public object _sequence, _ticks
    cdef public long long _modulus, _tick_modulus
    cdef public double tick_s, _arrival_s, age_s, board_s
    cdef public bint _sequence_known

    cdef double _elapsed(self, long long ticks, double host_s)
    @cython.locals(host_s=double, elapsed_s=double, slack=double, burst_s=double, expected=double, n_scans="long long")
    cpdef step(self, long long sequence, ticks, double arrival_s, double rate_hz)
    cdef _keep(self, sequence, ticks, double arrival_s, double elapsed_s)


cdef long long _nearest(long long residue, double value, long long modulus)
