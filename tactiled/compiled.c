/* The path of a scan, from bytes to filtered readings: arrays in, arrays out, nothing kept here.
 *
 * Every function does what numpy or plain Python does beside its call (`tactiled.compiled` loads this file), bit
 * for bit: sums are of whole numbers below 2^53, so that their order does not matter; all else is one operation
 * on one element, in the order in which numpy has it, without fused multiply-add (-ffp-contract=off) and without
 * functions other than rint and sqrt, which IEEE 754 defines exactly.
 *
 * Arrays are dense, with the last index moving fastest. n counts scans, c channels, t taxels. Arguments
 * before n belong to an object and stay; those from n on belong to a call.
 */
#include "compiled.h"

API const char *tactiled_source(void)
{
    return TACTILED_SOURCE; /* hash of this file, from hatch_build.py: a stale library is refused */
}

static real least(real a, real b) { return b < a ? b : a; }
static real most(real a, real b) { return b > a ? b : a; }

/* ---- bytes to frames (tactiled.wire) ---------------------------------------------------------------------- */

/* CRC-16 of polynomial x^16 + x^12 + x^5 + 1, most significant bit first. */
static unsigned crc16(unsigned crc, const uint8_t *octets, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        unsigned x = (crc >> 8 ^ octets[i]) & 0xFF;
        x ^= x >> 4;
        crc = (crc << 8 ^ x << 12 ^ x << 5 ^ x) & 0xFFFF;
    }
    return crc;
}

/* Scan message of a layout. Numbers of octets and places are those in the body, which is type and fields. */
typedef struct {
    int64_t limit;             /* octets before which a delimiter must come */
    int64_t crc, is_little;    /* first remainder; byte order of all numbers */
    int64_t type, type_width, body;
    int64_t at[3], width[3];   /* sequence, ticks, flags; width 0: the layout has no such field */
    int64_t counts_at, counts_width, counts_signed, channels;
} scan_message;

static int64_t number(const uint8_t *octets, int64_t width, int64_t is_little)
{
    uint64_t value = 0;
    for (int64_t k = 0; k < width; k++)
        value = value << 8 | octets[is_little ? width - 1 - k : k];
    return (int64_t)value;
}

/* Read the good scans at the beginning of `in`: COBS frames that end with their CRC and a zero. Stops before the
 * first frame that is anything else, before an incomplete one, and after `n_most` scans. `body` has room for `limit`
 * octets. Returns the number of scans; heads (scans, 4) are the end of each in `in`, sequence, ticks and flags. */
API ptrdiff_t tactiled_scans(const scan_message *scan, uint8_t *body, ptrdiff_t n_most, int64_t *heads,
                             int64_t *counts, const uint8_t *in, ptrdiff_t n)
{
    ptrdiff_t n_scans = 0, at = 0;
    for (; n_scans < n_most && at < n; n_scans++) {
        const uint8_t *zero = memchr(in + at, 0, (size_t)(n - at < scan->limit ? n - at : scan->limit));
        ptrdiff_t end = zero ? zero - in : at, size = 0, k = at;
        while (k < end) {
            ptrdiff_t code = in[k];
            if (k + code > end)
                break;
            memcpy(body + size, in + k + 1, (size_t)(code - 1));
            size += code - 1;
            k += code;
            if (code < 255 && k < end)
                body[size++] = 0;
        }
        if (!zero || k != end || (size -= 2) != scan->body ||
            number(body, scan->type_width, scan->is_little) != scan->type ||
            number(body + size, 2, scan->is_little) != crc16((unsigned)scan->crc, body, (size_t)size))
            break;
        *heads++ = at = end + 1;
        for (int field = 0; field < 3; field++)
            *heads++ = number(body + scan->at[field], scan->width[field], scan->is_little);
        int64_t sign = scan->counts_signed ? (int64_t)1 << (8 * scan->counts_width - 1) : 0;
        const uint8_t *octets = body + scan->counts_at;
        for (ptrdiff_t c = 0; c < scan->channels; c++, octets += scan->counts_width)
            *counts++ = (number(octets, scan->counts_width, scan->is_little) ^ sign) - sign;
    }
    return n_scans;
}

/* ---- readings (tactiled.detect.signal) ---------------------------------------------------------------------- */

/* Round readings to whole steps; where a reading is not ok, repeat the last good one (`last`, kept).
 * Returns whether all are ok. */
API int tactiled_hold(ptrdiff_t channels, real limit, real steps_per_volt, real *last, ptrdiff_t n,
                      const real *volts, const flag *valid, real *steps, flag *ok)
{
    int all = 1;
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t c = 0; c < channels; c++, volts++, valid++, steps++, ok++) {
            *ok = *valid && fabs(*volts) <= limit; /* not for NaN */
            if (*ok)
                last[c] = rint(*volts * steps_per_volt);
            *steps = last[c];
            all &= *ok;
        }
    return all;
}

/* Wavelet bank: filters of several lengths on n scans of all channels, out (n, levels, channels). `newest` is the
 * first of the n scans in a history (scans, channels) that goes back far enough; a filter's taps begin with that
 * of the newest scan. */
API void tactiled_bank(ptrdiff_t channels, ptrdiff_t levels, const int64_t *lengths, const real *taps, ptrdiff_t n,
                       const real *newest, real *out)
{
    enum { LANES = 4 };
    for (ptrdiff_t i = 0; i < n; i++, newest += channels) {
        const real *tap = taps;
        for (ptrdiff_t f = 0; f < levels; tap += lengths[f++], out += channels)
            for (ptrdiff_t c = 0; c < channels; c += LANES) {
                real sum[LANES] = {0};
                const real *x = newest + c;
                if (c + LANES <= channels)
                    for (ptrdiff_t k = 0; k < lengths[f]; k++, x -= channels)
                        for (int w = 0; w < LANES; w++)
                            sum[w] += tap[k] * x[w];
                else
                    for (ptrdiff_t k = 0; k < lengths[f]; k++, x -= channels)
                        for (int w = 0; w < channels - c; w++)
                            sum[w] += tap[k] * x[w];
                for (int w = 0; w < LANES && c + w < channels; w++)
                    out[c + w] = sum[w];
            }
    }
}

/* Contact of n scans.
 *
 * Pressure of a taxel: the sum of the `steps` of its channels `own` (taxels, sides), the largest one bounded by
 * `one_side` times the mean of the others where there are `least_sides` readings. `readings`, `contact` and
 * `release` are (taxels), or (n, taxels) where `each`.
 * Slope: `line` (n_line) on the totals of `held` (n, channels); `totals` holds n_line - 1 older ones, then n.
 */
API void tactiled_contact(ptrdiff_t channels, ptrdiff_t taxels, ptrdiff_t sides, ptrdiff_t n_line,
                          const int64_t *own, const real *signs, const real *sign, const real *total_weights,
                          const real *line, real one_side, real least_sides, real volts_per_step,
                          real slope_scale, ptrdiff_t n, const real *steps, const real *held,
                          const real *readings, const real *contact, const real *release, int each, real *totals,
                          real *pressure, real *n_touching, real *slope, flag *touches, flag *touched,
                          flag *released)
{
    for (ptrdiff_t i = 0; i < n; i++, steps += channels, held += channels) {
        ptrdiff_t level = each ? i * taxels : 0, n_touch = 0;
        real total = 0, risen = 0;
        released[i] = 1;
        for (ptrdiff_t t = 0; t < taxels; t++, pressure++, touches++) {
            real sum = 0, largest = -INFINITY, n_read = readings[level + t];
            for (ptrdiff_t c = 0; c < channels; c++)
                sum += signs[t * channels + c] * steps[c];
            for (ptrdiff_t s = 0; s < sides; s++)
                largest = most(largest, steps[own[t * sides + s]] * sign[own[t * sides + s]]);
            real rest = sum - largest;
            if (n_read >= least_sides)
                sum = rest + least(largest, one_side / most(n_read - 1, 1) * rest);
            *pressure = sum * volts_per_step / most(n_read, 1);
            *touches = *pressure > contact[level + t];
            n_touch += *touches;
            released[i] &= *pressure < release[level + t];
        }
        for (ptrdiff_t c = 0; c < channels; c++)
            total += held[c] * total_weights[c];
        totals[n_line - 1 + i] = total;
        for (ptrdiff_t k = 0; k < n_line; k++)
            risen += totals[i + k] * line[k];
        touched[i] = n_touch > 0;
        n_touching[i] = n_touch > 0 ? (real)n_touch : 1;
        slope[i] = risen * slope_scale / n_touching[i];
    }
}

/* Stuck channels: `signal.stuck_channels` states the rule. Arrays from `position` to `stayed` are kept between calls; the
 * turns of the last `history` scans are a ring. Returns whether any reading is stuck. */
API int tactiled_stuck(ptrdiff_t channels, ptrdiff_t sides, ptrdiff_t history, const real *sign,
                       const int64_t *others, const flag *judged, real pressed, int64_t n_turned, int64_t n_long,
                       real most_resting, int64_t *position, real *last, real *way, int64_t *run, real *began,
                       flag *turns, int64_t *n_turns, flag *noisy, flag *stayed, ptrdiff_t n, const real *steps,
                       flag *stuck)
{
    int any = 0;
    for (ptrdiff_t i = 0; i < n; i++, steps += channels, stuck += channels) {
        flag *turn = turns + *position * channels;
        int64_t resting = 0;
        *position = (*position + 1) % history;
        for (ptrdiff_t c = 0; c < channels; c++) {
            real now = (real)(steps[c] > last[c]) - (real)(steps[c] < last[c]), *origin = began + c * sides;
            int up = judged[c], down = judged[c];
            n_turns[c] -= turn[c];
            n_turns[c] += turn[c] = now * way[c] < 0;
            way[c] = now;
            last[c] = steps[c];
            run[c] = now != 0 ? 0 : run[c] + 1;
            if (now != 0)
                noisy[c] = n_turns[c] >= n_turned;
            resting += run[c] >= n_long / 2;
            for (ptrdiff_t s = 0; s < sides; s++) {
                ptrdiff_t other = others[c * sides + s];
                real reading = steps[other] * sign[other];
                if (now != 0)
                    origin[s] = reading;
                up &= reading - origin[s] >= pressed;
                down &= reading - origin[s] <= -pressed;
            }
            stayed[c] = (now == 0 && stayed[c]) || up || down;
        }
        for (ptrdiff_t c = 0; c < channels; c++) {
            stuck[c] = stayed[c] || (noisy[c] && run[c] >= n_long && (real)resting <= most_resting);
            any |= stuck[c];
        }
    }
    return any;
}
