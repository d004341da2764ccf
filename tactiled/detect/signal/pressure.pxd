"""Types of C for pressure.py, which hatch_build.py compiles."""

cdef extern from "math.h" nogil:
    cpdef double exp(double x)
    cpdef double expm1(double x)
    cpdef double sqrt(double x)

cdef double _TO_WHOLE, _INFINITE, _NO_NUMBER, _ONE_SIDE, _UNKNOWN, _SECOND_DIFFERENCE, ROUNDING, _MEDIAN, _LOG_DOUBT, _STATED_SMALL
cdef double _RELEASE_OF_CONTACT, _LOADING_OF_LOAD, _LOADING_OF_CONTACT, _LOADING_SDS, _SWING_SDS, _TURN, _BOTH_SIDES, _CREST, STOPPED
cdef long LEAST_SIDES, _GROUP_SCANS, _GROUPS, _FEWEST, _MOST_POOLED, _MEANS, _LEAST_TURNS, _MOST_RESTS


cdef class Hold:
    cdef public long n_channels
    cdef public double full_scale_volts, volts_per_step
    cdef public double[::1] last

    cpdef bint take(self, long n, const double[::1] readings, const unsigned char[::1] valid, double[::1] steps, unsigned char[::1] ok)

    cpdef double rounded(self, double reading)


cdef class Quietest:
    cdef public long n_wanted
    cdef public double[::1] power, sum
    cdef public long long[::1] n
    cdef public unsigned char[::1] is_mean

    cpdef take(self, long c, double power)


cdef class RestNoise:
    cdef public long n_channels, n_scans, n_known, n_mean, n_summed, n_means
    cdef public double early, most_wander
    cdef public bint is_early
    cdef public Quietest quietest, slowest
    cdef public double[::1] steps, least_step, early_noise, noise, means, wander
    cdef public long long[::1] n_good
    cdef public unsigned char[::1] ok

    cpdef interrupt(self)

    cpdef bint take(self, long first, const double[::1] steps, const unsigned char[::1] ok)

    cdef _take_mean(self, long newest)

    cdef _take_group(self)

    cdef _take_early(self)


cdef class RestSwing:
    cdef public long n_taxels, n_window, n_declared, n_scans
    cdef public double early
    cdef public bint is_seen
    cdef public double[::1] value, last, older, sum, square, bend, highest, lowest, power
    cdef public long long[::1] side, turns, n_rests

    cpdef interrupt(self)

    cpdef double level(self, long k)

    cpdef take(self, const double[::1] levels)

    cdef _take_one(self, long k, double value, double level)


cdef class Levels:
    cdef public double contact, release, loading, least_contact
    cdef public bint all_given

    cpdef double contact_at(self, double noise, double swing)

    cpdef double release_at(self, double noise, double swing)

    cpdef double loading_at(self, double load, double slope_sd)


cdef class Pressure:
    cdef public long n_channels, n_taxels, n_sides, n_hidden, n_pads, n_room, n_scans, n_settle, n_steady
    cdef public double rate_hz, volts_per_step, slope_scale, slope_noise, set_of_load, set_per_scan, of_largest, forget_per_scan, rise_per_scan
    cdef public bint is_begun, is_field, is_first, all_ok
    cdef public str state, previous
    cdef public Hold hold
    cdef public Levels levels
    cdef public RestNoise rest
    cdef public RestSwing swing
    cdef public long long[::1] own, counts, pads, unread
    cdef public double[::1] sign, total_weights, line, totals, set, largest, heaviest, pressure, taxel_noise, of_noise, steps, slope, loading
    cdef public unsigned char[::1] ok, touches, released, lost, is_free, may_be_old, touched, swings

    cpdef make_room(self, long n)

    cpdef forget_contact(self)

    cpdef interrupt(self, long n_missing)

    cpdef take(self, long n, const double[::1] readings, const unsigned char[::1] valid)

    cdef _measure(self, long i, const double[::1] readings)

    cpdef bint step(self, long scan)

    cpdef go(self, str state)

    cdef double _total_noise(self)
