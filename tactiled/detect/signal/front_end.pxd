"""Types of C for front_end.py, which hatch_build.py compiles."""

cdef extern from "math.h":
    cpdef double sqrt(double x)

cdef double _INFINITE, _UNKNOWN, _CLIP, _ROUNDING, _MEAN_ABS, _LEAST_JUMP, _JUMP_NOISES, _JUMP_TIMES
cdef double _LOADED, _MOST_JUMP, _RELIEVED, _MOST_SPREAD, _LEAST_PRESSED
cdef long _HISTORY, _TURNED, _LONG, _NOISE_LEVELS, _CLIPPED_AFTER, _FEWEST_LOADED, _SPARE


cdef class StuckChannels:
    cdef public long n_channels, n_sides, position
    cdef public double pressed, most_resting
    cdef public bint is_begun
    cdef public double[::1] sign, last, way, began
    cdef public long long[::1] others, run, n_turns
    cdef public unsigned char[::1] judged, turns, noisy, stayed

    cpdef bint take(self, long n, long first, const double[::1] steps, unsigned char[::1] stuck)


cdef class Bank:
    cdef public long n_channels, n_filters
    cdef public long long[::1] lengths
    cdef public double[::1] taps

    cpdef take(self, long n, long first, const double[::1] steps, double[::1] out)


cdef class Jumps:
    cdef public long n_channels, n_taxels
    cdef public bint is_out
    cdef public double[::1] accepted, change, usual
    cdef public unsigned char[::1] own, found, out, jumps, is_loaded

    cpdef take(self, double[::1] readings, long first, double[::1] loads, double[::1] noise, bint press_is_over)
    cdef _find(self, long first, double[::1] loads, double least, double heaviest, double[::1] noise)


cdef class RelievedSides:
    cdef public long n_taxels, n_own
    cdef public bint is_due
    cdef public long long[::1] own
    cdef public double[::1] weights, even, load, side, high, proportion, weight
    cdef public unsigned char[::1] relieved

    cpdef reset(self)
    cpdef correct(self, double[::1] readings, long first, double[::1] response)


cdef class NoiseFloor:
    cdef public long n_channels, n
    cdef public double least, n_scans
    cdef public double[::1] mean_abs, last, step, sd

    cpdef take(self, double[::1] readings, double[::1] details)
    cdef double _known(self, long channel)


cdef class Readings:
    cdef public StuckChannels stuck
    cdef public Bank bank
    cdef public Jumps jumps
    cdef public NoiseFloor floor
    cdef public RelievedSides relief
    cdef public long n_channels, n_taxels, n_own, n_hold, n_border, n_history, row, n_room
    cdef public double rate_hz, volts_per_step, most_dropped, load, shear_sd, total_sd, load_sd
    cdef public bint is_begun, is_read, keeps_enough, is_lost
    cdef public object recent, offset_of
    cdef public long long[::1] own, n_good, n_bad
    cdef public const double[::1] steps, offset_s
    cdef public const unsigned char[::1] read
    cdef public double[::1] weights, history, remainders, rows, details, bent, baseline, readings, pressed, older, oldest
    cdef public double[::1] remainder
    cdef public unsigned char[::1] dropped, ok, is_stuck, is_out

    cpdef follow(self, gate, channel_offset_s)
    cpdef take(self, long scan, bint in_contact, bint press_is_over)
    cpdef rest(self, double part)
    cpdef interrupt(self)
    cdef _take_steps(self, long at)
    cdef _take_instant(self)
    cdef _take_out(self, bint in_contact)
    cdef _responses(self, double[::1] readings, long first, double[::1] out)
    cdef _respond(self, bint in_contact)
    cdef _take_noise(self)
