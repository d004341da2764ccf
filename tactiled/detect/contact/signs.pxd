"""Types of C for signs.py, which hatch_build.py compiles."""

cdef extern from "math.h":
    cpdef double log(double x)
    cpdef double sqrt(double x)

cdef double LEAST_RATIO, _EVEN, _UNKNOWN, _LOADED, _SUDDEN_DROP, _LONGEST_S, _KEPT
cdef long _SHAPE, _RATIO, _OWN, _CHANGES, _TURNS, _SPREADS, _WANDER, _DETAILS, _SINCE, _GROWTH, _ROUGHNESS, _JERK
cdef long _NOISE, _RIPPLE, _HAND, _MOVES


cdef class Signs:
    cdef public long n_taxels, n, at, n_scans, length, n_mean, n_drop, n_growth, n_longest
    cdef public double look_s, shear_per_friction, shear_scale, total_x, total_y, moment, total_load, keep_fast, keep_slow, keep_mean
    cdef public double is_seen, ratio_x, ratio_y, turn, ratio, growth, whole, ratio_noise, largest, dropped_from
    cdef public double since_largest_s, steps2, grown_to, log_growth_s, growth_slows
    cdef public double[::1] x, y, scan_load, scan_x, scan_y, over_load, load, shear_x, shear_y, row, taps, past_x, past_y, past_ratio
    cdef public double[::1] past_log_ratio, past_log_load, parts, since, parts_x, parts_y, load_parts, fast, slow, lag, power, turns
    cdef public long long[::1] change_looks, turn_looks, spread_looks, wander_looks, move_looks, n_taps, pairs

    cpdef take(self, double[::1] reading, double[::1] zero)
    cpdef look(self, double noise, double acceleration)
    cdef _store(self)
    cdef long _back(self, long looks)
    cdef _take_shape(self)
    cdef _take_course(self)
    cdef _take_growth(self)
    cdef _take_wander(self, double noise)
    cdef _take_moves(self, double noise)
    cdef _take_ripple(self)
