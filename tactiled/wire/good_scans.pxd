"""Types of C for good_scans.py, which hatch_build.py compiles."""


cdef class GoodScans:
    cdef public long limit, crc_start, type_number, body_bytes, counts_at, counts_width, n_most, n_channels
    cdef public bint is_little, has_ticks
    cdef public long long sign
    cdef public long long[::1] places, widths, heads, counts
    cdef public unsigned char[::1] body
    cdef public object rows

    cdef long _read(self, const unsigned char[::1] data)
    cdef long _unstuff(self, const unsigned char[::1] data, long at)
    cdef bint _is_whole(self)
    cdef long long _number(self, long at, long width)
