"""Types of C for filter.py, which hatch_build.py compiles."""

cimport cython

cdef extern from "math.h":
    cpdef double log(double x)
    cpdef double exp(double x)
    cpdef double sqrt(double x)

cdef double FIVE_PERCENT, INCIPIENT_SHARE, INCIPIENT_USED, LEAST_GROSS_USED, RIPPLE_P, NEEDED_UTILISATION
cdef double LOOK_S, _INFINITE, LEAST_RATIO, _LEAST_BORNE
cdef double _MOST_ODDS, _LEAST_ODDS, _LONG_S, _PEAK_S, _BORNE_S, _ONSETS, _ENDS, _FILTER_PART
cdef double _SLIDE_SD, _SLIDE_S, _WALK_SD, _CONTACT_SD, _LEAST_SD, _MOST_UNLOADED
cdef double _OFF, _SURELY_OVER, _GROWN, _SURELY, _SURELY_FALLS
cdef double _LEAST_VARIANCE, _AVERAGE_S, _PLAUSIBLE_SDS, _LOG_FRICTION, FRICTION_LOG_SD, _UNTOLD
cdef double _WITHOUT_ZERO
cdef long LOAD_CHANGE
cdef unsigned int _ALL_LEAVES, _DE_BRUIJN
cdef int[::1] _PLACES

cpdef double kept_load(double log_load_change)


cdef class Trees:
    cdef public double[::1] first, limit, leaf, scores
    cdef public int[::1] output, leaf_of, of_feature, tree
    cdef public signed char[::1] nan_fails
    cdef public unsigned int[::1] left, reached

    @cython.locals(
        k=Py_ssize_t, t=Py_ssize_t, feature=Py_ssize_t, end=Py_ssize_t, value=double, lowest="unsigned int", place=int
    )
    cpdef evaluate(self, double[::1] row)


cdef class Memory:
    cdef public double[::1] row, times_s
    cdef public double base_odds, largest, filtered, sliding_part, movement, slid_log, slid_s, borne
    cdef public double crossing_log, since_likely_s, before_log
    cdef public bint is_likely

    cpdef begin_contact(self)
    cpdef take(self, double p, double ratio, double step_s, double kept)


cdef class FrictionMemory:
    cdef public double log_mean, variance, contact_log_mean, contact_variance, most_variance

    cpdef begin_contact(self)
    cpdef widen(self, double log_sd)
    cpdef walk(self, double time_s)
    cpdef learn(self, double p_sliding, double ratio, double kept, double step_s)


cdef class SlipHysteresis:
    cdef public double incipient_p, gross_p, least, ratio
    cdef public long n_off, n_settle, n_low, n_looks
    cdef public bint is_open, is_gross

    cpdef settle(self)
    cpdef close(self)
    cpdef look(self, double p_incipient, double p_sliding, double ratio, double ratio_sd)


cdef class Posterior:
    cdef public double[::1] cells, logs, shown, edges, middles, shares
    cdef public tuple soon, utilisation, friction
    cdef public double new_part, p_sliding, slipping_share
    cdef public bint is_begun, is_gross

    cpdef begin(self)
    cpdef take(self, double[::1] scores, double[::1] soon_scores, double signs_odds, double ratio,
               double log_friction, double variance, bint was_seen, bint ripple_travels)
    cpdef publish(self, bint is_gross, double least_sliding, double ratio, double log_friction, double variance)
    cdef double _quantile(self, double wanted)


cdef class ContactFilter:
    cdef public object signs, unit
    cdef public Trees sign_trees, state_trees, soon_trees
    cdef public Memory memory
    cdef public FrictionMemory friction_memory
    cdef public Posterior posterior
    cdef public SlipHysteresis hysteresis
    cdef public double[::1] sign_row, over_load, row, past
    cdef public long long[::1] columns
    cdef public long n_look, n_kept, n_past, newest
    cdef public double per_friction, look_s, growth_s, radius_mm, base_odds, prior_p, ratio, slid_at, rippled_s
    cdef public double zero_sd, total_x, total_y, moment, load
    cdef public bint is_begun, is_look, is_known
    cdef public tuple friction, p_gross

    cpdef take(self, double time_s, reading, zero, double noise, double acceleration, bint was_seen,
               double rippled_s, bint touches)
    cpdef look(self, double noise, double acceleration, bint was_seen, bint touches)
    cpdef publish(self)
    cdef _keep(self, double time_s)
