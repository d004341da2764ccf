"""Types of C for filter.py, which hatch_build.py compiles."""

cimport cython

cdef extern from "math.h":
    cpdef double exp(double x)
    cpdef double sqrt(double x)

cdef double CLOSING_PART, FIVE_PERCENT, INCIPIENT_SHARE, INCIPIENT_USED, LEAST_BORNE, LEAST_GROSS_USED, RIPPLE_P
cdef double NEEDED_UTILISATION, LOOK_S, _SURELY_FALLS
cdef long LOAD_CHANGE


cdef class ContactFilter:
    cdef public object signs, unit, sign_trees, state_trees, soon_trees
    cdef public object memory, friction_memory, posterior, hysteresis
    cdef public object sign_row, memory_row, row, state_scores, soon_scores
    cdef public double[::1] over_load, past, sign_scores
    cdef public long long[::1] columns
    cdef public long n_look, n_kept, n_past, newest
    cdef public double per_friction, look_s, growth_s, radius_mm, prior_p, ratio, slid_at, rippled_s
    cdef public double zero_sd, total_x, total_y, moment, load
    cdef public bint is_begun, is_look, is_known
    cdef public tuple friction, p_gross

    cpdef take(self, double time_s, reading, zero, double noise, double acceleration, bint was_seen,
               double rippled_s, bint touches)
    @cython.locals(row="double[::1]", sign_row="double[::1]", memory_row="double[::1]")
    cpdef look(self, double noise, double acceleration, bint was_seen, bint touches)
    cpdef publish(self)
    cdef _keep(self, double time_s)
