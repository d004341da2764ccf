/* Loads and shears of the taxels, scan by scan (tactiled.detect.grip.readings), with the state in one block.
 *
 * `compiled.c` has the rules. The caller allocates the block, which stays in place, and hands it to every call.
 */
#include "compiled.h"

/* ---- responses and noise (tactiled.detect.grip.observe, .relief) ------------------------------------------------ */

/* Responses (3, taxels) of readings (channels): `weights` of the channels `own`, both (n, 3, taxels). */
static void loads(ptrdiff_t taxels, ptrdiff_t n, const int64_t *own, const real *weights, const real *volts,
                  real *out)
{
    for (ptrdiff_t i = 0; i < 3 * taxels; i++) {
        real sum = 0;
        for (ptrdiff_t k = i; k < 3 * taxels * n; k += 3 * taxels)
            sum += weights[k] * volts[own[k]];
        out[i] = sum;
    }
}

/* Variances of the totals of load, shear x and shear y (3), from the noise of the channels. */
static void total_noise(ptrdiff_t taxels, ptrdiff_t n, const int64_t *own, const real *weights,
                        const real *channel_sd, real *out)
{
    for (ptrdiff_t kind = 0; kind < 3; kind++) {
        out[kind] = 0;
        for (ptrdiff_t i = kind * taxels; i < (kind + 1) * taxels; i++) {
            real sum = 0;
            for (ptrdiff_t k = i; k < 3 * taxels * n; k += 3 * taxels) {
                real sd = weights[k] * channel_sd[own[k]];
                sum += sd * sd;
            }
            out[kind] += sum;
        }
    }
}

/* Correct the response (3, taxels) of a scan where sides are relieved: `RelievedSides.correct`.
 *
 * Sides (half, axis, taxel) have `weights` of the channels `own`, both (n, 4, taxels), and readings `even` (4, taxels)
 * under an even load of 1. `numbers`: part of the other side below which a side is relieved, most spread, least
 * pressed part. load (taxels), proportion and its weight (2, taxels) are kept. relieved (2, taxels). */
static void relieve(ptrdiff_t taxels, ptrdiff_t n, const int64_t *own, const real *weights, const real *even,
                    const real *numbers, real *load, real *proportion, real *weight, const real *readings,
                    real *response, uint8_t *relieved)
{
    for (ptrdiff_t t = 0; t < taxels; t++) {
        real side[4], high[2], other = INFINITY;
        for (ptrdiff_t s = 0; s < 4; s++) {
            ptrdiff_t i = s * taxels + t;
            side[s] = 0;
            for (ptrdiff_t k = i; k < 4 * taxels * n; k += 4 * taxels)
                side[s] += weights[k] * readings[own[k]];
            side[s] /= even[i];
        }
        for (int a = 0; a < 2; a++) {
            high[a] = at_least(side[a], side[2 + a]);
            relieved[a * taxels + t] =
                at_most(side[a], side[2 + a]) < numbers[0] * high[a] && high[a] > numbers[2] * load[t];
            if (!relieved[a * taxels + t])
                other = at_most((side[a] + side[2 + a]) / 2, other);
        }
        int whole = !relieved[t] && !relieved[taxels + t];
        load[t] = whole ? response[t] : at_least(response[t] / numbers[1], other < INFINITY ? other : load[t]);
        for (int a = 0; a < 2; a++) {
            real *shear = response + (1 + a) * taxels + t, *share = proportion + a * taxels + t;
            real pressed = high[a] - (relieved[(1 - a) * taxels + t] ? load[t] : (side[1 - a] + side[3 - a]) / 2);
            if (relieved[a * taxels + t])
                *shear = (side[a] >= side[2 + a] ? 1 : -1) * *share * at_least(pressed, 0);
            else if (pressed > numbers[2] * load[t]) {
                weight[a * taxels + t] += pressed * pressed;
                *share += pressed * (fabs(*shear) - *share * pressed) / weight[a * taxels + t];
            }
        }
        response[t] = load[t];
    }
}

static real noise_of(real mean_abs, real per_sd, real step, real per_rounding, real floor)
{
    real noise = mean_abs / per_sd, rounding = (step < INFINITY ? step : 0) / per_rounding;
    return at_least(sqrt(noise * noise + rounding * rounding), floor);
}

/* Noise floor after a scan: `NoiseFloor.take`. mean_abs (levels, channels), last, step and sd (channels) are kept;
 * details (levels, channels). */
static void follow_floor(ptrdiff_t channels, ptrdiff_t levels, real per_sd, real per_rounding, real floor,
                         real *mean_abs, real *last, real *step, real *sd, real part, real clip, const real *volts,
                         const real *details)
{
    for (ptrdiff_t c = 0; c < channels; c++) {
        real moved = fabs(volts[c] - last[c]), largest = 0;
        last[c] = volts[c];
        if (moved > 0 && moved < step[c])
            step[c] = moved;
        for (ptrdiff_t k = 0; k < levels; k++)
            largest = at_least(mean_abs[k * channels + c], largest);
        real most = clip * noise_of(largest, per_sd, step[c], per_rounding, floor);
        largest = 0;
        for (ptrdiff_t k = 0; k < levels; k++) {
            real *mean = mean_abs + k * channels + c;
            *mean += part * (at_most(fabs(details[k * channels + c]), most) - *mean);
            largest = at_least(*mean, largest);
        }
        sd[c] = noise_of(largest, per_sd, step[c], per_rounding, floor);
    }
}

/* ---- loads and shears of the scans (tactiled.detect.grip.readings) ---------------------------------------------- */

/* Constants, in the order in which `_constants` of Python has them. */
struct readings_numbers {
    real limit, volts_per_step, rate_hz, n_hold, most_dropped;
    real per_sd, per_rounding, floor_scans, clip, clipped_after;
    real relief[3], first_weight;
    struct {
        real least, noises, times, loaded, fewest, most;
    } jump;
    real stuck_pressed, stuck_turned, stuck_long, stuck_resting, stuck_history;
};

/* Constant arrays of an array of sensors, in the order in which `_constants` of Python has them. */
struct readings_arrays {
    const int64_t *lengths; /* of the filters */
    const real *taps;
    const int64_t *own; /* channels of the responses, and their weights */
    const real *weights;
    const int64_t *side_own; /* of the sides */
    const real *side_weights, *even;
    const flag *taxel_channels;
    const real *sign; /* of the search for stuck channels */
    const int64_t *others;
    const flag *judged;
};

struct readings {
    struct {
        real load, shear_sd, total_sd, load_sd, is_read, is_lost, is_switched;
    } seen; /* what the caller reads */
    const struct readings_numbers *with;
    const struct readings_arrays *array;
    ptrdiff_t channels, taxels, levels, n_own, n_side_own, n_history, border, sides;
    int64_t n_floor, position, is_begun, is_stuck_begun, row, n_rows, is_out;
    /* of the caller: the scan as it came, with the delays of its channels; the history and what is not read */
    const real *volts, *offset_s;
    const flag *valid;
    real *history;
    flag *dropped, *switched;
    real *baseline, *held, *rows, *older, *oldest, *remainders;
    real *mean_abs, *floor_last, *floor_step, *floor_sd; /* noise floor */
    real *load, *proportion, *proportion_weight;         /* relieved sides */
    flag *relieved;
    real *accepted; /* jumps */
    flag *out;
    real *stuck_last, *way, *began; /* stuck channels */
    int64_t *run, *n_turns;
    flag *turns, *noisy, *stayed;
    int64_t *n_good, *n_bad; /* readings of each channel without a break */
    /* of one scan */
    real *readings, *pressed, *remainder, *details, *bent, *change, *usual;
    flag *ok, *stuck, *jumped, *jumps, *is_taken, *is_loaded, *was_relieved;
};

/* Find the channels whose readings jump, or did so one scan before: `JumpGate.take`, or its `skip` where jumps cannot
 * be told. `jumped` (channels) is zero before. */
static void find_jumps(struct readings *r, const real *readings, int is_pressed, flag *jumped)
{
    const struct readings_numbers *with = r->with;
    const ptrdiff_t channels = r->channels, taxels = r->taxels;
    const real *load = r->history + (r->n_history - 1) * 3 * taxels; /* of the scan before */
    real *change = r->change, *usual = r->usual, largest = 0, heaviest = load[0], sum = 0;
    flag *is_loaded = r->is_loaded, *jumps = r->jumps;
    int any = 0;
    ptrdiff_t n_loaded = 0, n_struck = 0;
    for (ptrdiff_t c = 0; c < channels; c++) {
        change[c] = fabs(readings[c] - r->accepted[c]);
        largest = at_least(change[c], largest);
    }
    for (ptrdiff_t t = 0; t < taxels; t++) {
        sum += load[t];
        heaviest = at_least(load[t], heaviest);
    }
    const real least = with->jump.least * sum / (real)taxels;
    if (!is_pressed || (!r->is_out && largest <= least)) {
        memcpy(r->accepted, readings, octets(channels));
        r->is_out = 0;
        return;
    }
    for (ptrdiff_t t = 0; t < taxels; t++) {
        is_loaded[t] = load[t] > with->jump.loaded * heaviest;
        if (!is_loaded[t])
            continue;
        real moved = 0;
        for (ptrdiff_t c = 0; c < channels; c++)
            if (r->array->taxel_channels[t * channels + c])
                moved = at_least(change[c], moved);
        ptrdiff_t at = n_loaded++; /* in ascending order */
        for (; at > 0 && usual[at - 1] > moved; at--)
            usual[at] = usual[at - 1];
        usual[at] = moved;
    }
    memset(jumps, 0, (size_t)channels);
    if ((real)n_loaded >= with->jump.fewest) {
        real median = (usual[(n_loaded - 1) / 2] + usual[n_loaded / 2]) / 2;
        real from = at_least(with->jump.times * median, least);
        for (ptrdiff_t c = 0; c < channels; c++)
            jumps[c] = change[c] > at_least(with->jump.noises * r->floor_sd[c], from);
        for (ptrdiff_t t = 0; t < taxels; t++) {
            int is_struck = 0;
            for (ptrdiff_t c = 0; c < channels; c++)
                is_struck |= jumps[c] && r->array->taxel_channels[t * channels + c];
            n_struck += is_struck && is_loaded[t];
        }
        if ((real)n_struck > with->jump.most * (real)n_loaded)
            memset(jumps, 0, (size_t)channels);
    }
    for (ptrdiff_t c = 0; c < channels; c++) {
        jumped[c] = jumps[c] || (r->is_out && r->out[c]);
        any |= jumps[c];
        if (!jumps[c])
            r->accepted[c] = readings[c];
    }
    memcpy(r->out, jumps, (size_t)channels);
    r->is_out = any;
}

/* Round the scan to whole steps (channels), which stay in `rows` for the filters, and find its bad readings. */
static const real *next_steps(struct readings *r, flag *ok, flag *stuck)
{
    const struct readings_numbers *with = r->with;
    const struct readings_arrays *array = r->array;
    const ptrdiff_t channels = r->channels;
    if (r->row == r->n_rows) {
        r->row = r->border;
        memmove(r->rows, r->rows + (r->n_rows - r->border) * channels, octets(r->border * channels));
    }
    real *steps = r->rows + r->row++ * channels;
    tactiled_hold(channels, with->limit, 1 / with->volts_per_step, r->held, 1, r->volts, r->valid, steps, ok);
    if (!r->is_begun)
        for (ptrdiff_t i = 1; i <= r->border; i++)
            memcpy(steps - i * channels, steps, octets(channels));
    if (!r->is_stuck_begun) {
        r->is_stuck_begun = 1;
        memcpy(r->stuck_last, steps, octets(channels));
        for (ptrdiff_t i = 0; i < channels * r->sides; i++)
            r->began[i] = steps[array->others[i]] * array->sign[array->others[i]];
    }
    tactiled_stuck(channels, r->sides, (ptrdiff_t)with->stuck_history, array->sign, array->others, array->judged,
                   with->stuck_pressed, (int64_t)with->stuck_turned, (int64_t)with->stuck_long, with->stuck_resting,
                   &r->position, r->stuck_last, r->way, r->run, r->began, r->turns, r->n_turns, r->noisy, r->stayed,
                   1, steps, stuck);
    return steps;
}

/* Take out taxels with a channel that is bad for long, by the readings that are ok (channels): `_take_out`.
 * `out` (channels), zero before, gets their channels. */
static void take_out(struct readings *r, const flag *ok, int in_contact, flag *out)
{
    const ptrdiff_t channels = r->channels, taxels = r->taxels;
    ptrdiff_t n_bad = 0, n_dropped = 0;
    int waits = 0;
    for (ptrdiff_t c = 0; c < channels; c++) {
        r->n_bad[c] = ok[c] ? 0 : r->n_bad[c] + 1;
        n_bad += !ok[c];
    }
    for (ptrdiff_t t = 0; t < taxels; t++)
        n_dropped += r->dropped[t];
    r->seen.is_lost = 0;
    r->seen.is_read = 1;
    if (!n_bad && !n_dropped)
        return;
    n_dropped = 0;
    for (ptrdiff_t t = 0; t < taxels; t++) {
        const flag *own = r->array->taxel_channels + t * channels;
        int is_bad = 0, is_late = 0;
        for (ptrdiff_t c = 0; c < channels; c++) {
            is_bad |= own[c] && (real)r->n_bad[c] > r->with->n_hold;
            is_late |= own[c] && !ok[c];
        }
        if (in_contact && is_bad && !r->dropped[t])
            r->seen.is_lost = 1;
        r->dropped[t] = (flag)(is_bad || (in_contact && r->dropped[t]));
        n_dropped += r->dropped[t];
        waits |= is_late && !r->dropped[t];
        for (ptrdiff_t c = 0; c < channels; c++)
            out[c] |= own[c] && r->dropped[t];
    }
    r->seen.is_read = !waits && (real)n_dropped <= r->with->most_dropped;
}

/* Append the response of readings (channels) to the history, and the mean square of shears that the remainders of
 * interpolation would be. */
static void respond(struct readings *r, const real *pressed, const real *remainder, int in_contact)
{
    const struct readings_arrays *array = r->array;
    const ptrdiff_t taxels = r->taxels, row = 3 * taxels, last = r->n_history - 1;
    real *response = r->history + last * row, *bent = r->bent, load = 0, square = 0;
    flag *was_relieved = r->was_relieved;
    memmove(r->history, r->history + row, octets(last * row));
    memmove(r->remainders, r->remainders + 1, octets(last));
    memcpy(was_relieved, r->relieved, 2 * (size_t)taxels);
    loads(taxels, r->n_own, array->own, array->weights, pressed, response);
    if (in_contact && r->n_side_own)
        relieve(taxels, r->n_side_own, array->side_own, array->side_weights, array->even, r->with->relief, r->load,
                r->proportion, r->proportion_weight, pressed, response, r->relieved);
    r->seen.is_switched = 0;
    for (ptrdiff_t t = 0; t < taxels; t++) {
        r->switched[t] = r->relieved[t] != was_relieved[t] || r->relieved[taxels + t] != was_relieved[taxels + t];
        if (r->switched[t])
            r->seen.is_switched = 1;
        if (r->dropped[t])
            response[t] = response[taxels + t] = response[2 * taxels + t] = 0;
        load += response[t];
    }
    r->seen.load = load / (real)taxels;
    loads(taxels, r->n_own, array->own, array->weights, remainder, bent);
    for (ptrdiff_t i = taxels; i < row; i++)
        square += bent[i] * bent[i];
    r->remainders[last] = square / (real)(2 * taxels);
    if (!r->is_begun) {
        memset(r->remainders, 0, octets(r->n_history));
        for (ptrdiff_t i = 0; i < last; i++)
            memcpy(r->history + i * row, response, octets(row));
    }
}

/* Take a scan: `TaxelReadings.take`. */
API void tactiled_readings_take(struct readings *r, int in_contact, int is_pressed)
{
    const struct readings_numbers *with = r->with;
    const struct readings_arrays *array = r->array;
    const ptrdiff_t channels = r->channels;
    real *readings = r->readings, *pressed = r->pressed, *remainder = r->remainder, *details = r->details;
    flag *ok = r->ok, *stuck = r->stuck, *jumped = r->jumped, *out = r->is_taken;
    const real *steps = next_steps(r, ok, stuck);
    tactiled_bank(channels, r->levels, array->lengths, array->taps, 1, steps, details);
    memset(jumped, 0, (size_t)channels);
    memset(out, 0, (size_t)channels);
    for (ptrdiff_t c = 0; c < channels; c++) {
        r->n_good[c] = ok[c] ? r->n_good[c] + 1 : 0;
        readings[c] = steps[c] * with->volts_per_step;
    }
    find_jumps(r, readings, is_pressed, jumped);
    for (ptrdiff_t c = 0; c < channels; c++) {
        const real now = readings[c], older = r->is_begun ? r->older[c] : now;
        const real oldest = r->is_begun ? r->oldest[c] : now;
        const real back = at_most(at_least(r->offset_s[c] * with->rate_hz, 0), 1);
        ok[c] = ok[c] && !stuck[c] && !jumped[c];
        r->oldest[c] = older;
        r->older[c] = now;
        pressed[c] = (jumped[c] ? r->accepted[c] : now - back * (now - older)) - r->baseline[c];
        remainder[c] = 0.5 * back * (1 - back) * ((now - older) - (older - oldest));
    }
    take_out(r, ok, in_contact, out);

    int is_full = 1;
    for (ptrdiff_t c = 0; c < channels; c++)
        is_full &= r->n_good[c] > r->border || out[c];
    if (is_full) {
        const real n = (real)++r->n_floor;
        follow_floor(channels, r->levels, with->per_sd, with->per_rounding, with->volts_per_step, r->mean_abs,
                     r->floor_last, r->floor_step, r->floor_sd, 1 / at_most(n, with->floor_scans),
                     n > with->clipped_after ? with->clip : INFINITY, readings, details);
    }
    respond(r, pressed, remainder, in_contact);
    r->is_begun = 1;

    real variances[3], largest = 0;
    total_noise(r->taxels, r->n_own, array->own, array->weights, r->floor_sd, variances);
    for (ptrdiff_t i = 0; i < r->n_history; i++)
        largest = at_least(r->remainders[i], largest);
    const real shear = variances[1] + variances[2], shear_sd = sqrt(shear / (real)(2 * r->taxels));
    r->seen.shear_sd = sqrt(shear_sd * shear_sd + largest);
    r->seen.total_sd = sqrt(shear / 2);
    r->seen.load_sd = sqrt(variances[0]) / (real)r->taxels;
}

/* Let the baseline follow the readings of a scan without contact, by a part. */
API void tactiled_readings_rest(struct readings *r, real part)
{
    for (ptrdiff_t c = 0; c < r->channels; c++)
        r->baseline[c] += part * (r->older[c] - r->baseline[c]);
}

/* Forget which sides are relieved: `RelievedSides.reset`. */
API void tactiled_readings_release(struct readings *r)
{
    for (ptrdiff_t i = 0; i < 2 * r->taxels; i++) {
        r->relieved[i] = 0;
        r->proportion[i] = 2;
        r->proportion_weight[i] = r->with->first_weight;
    }
    memset(r->load, 0, octets(r->taxels));
}

/* Let no window reach back before a gap. */
API void tactiled_readings_interrupt(struct readings *r)
{
    r->is_begun = 0;
    memset(r->n_good, 0, octets(r->channels));
}

/* Begin in a block of zeros; return the number of reals that it takes, with no block only that number.
 * `sizes`: channels, taxels, filters, channels of a response and of a side (0: no sides), scans of the history,
 * scans before a filter is full, other sides of a taxel. */
API ptrdiff_t tactiled_readings(const int64_t *sizes, const struct readings_numbers *with,
                                const struct readings_arrays *array, const real *volts, const flag *valid,
                                const real *offset_s, real *history, flag *dropped, flag *switched, real *block)
{
    enum { SPARE = 64 }; /* scans after which the kept ones move to the front */
    const ptrdiff_t channels = sizes[0], taxels = sizes[1], levels = sizes[2], border = sizes[6], sides = sizes[7];
    struct readings begun = {.channels = channels, .taxels = taxels, .levels = levels, .n_own = sizes[3],
                             .n_side_own = sizes[4], .n_history = sizes[5], .border = border, .sides = sides,
                             .with = with, .array = array, .volts = volts, .valid = valid,
                             .offset_s = offset_s, .history = history,
                             .dropped = dropped, .switched = switched, .row = border, .n_rows = border + SPARE};
    ptrdiff_t at = reals(sizeof begun);
    begun.baseline = place(block, &at, channels);
    begun.held = place(block, &at, channels);
    begun.rows = place(block, &at, begun.n_rows * channels);
    begun.older = place(block, &at, channels);
    begun.oldest = place(block, &at, channels);
    begun.accepted = place(block, &at, channels);
    begun.remainders = place(block, &at, begun.n_history);
    begun.out = place(block, &at, reals((size_t)channels));
    begun.mean_abs = place(block, &at, levels * channels);
    begun.floor_last = place(block, &at, channels);
    begun.floor_step = place(block, &at, channels);
    begun.floor_sd = place(block, &at, channels);
    begun.load = place(block, &at, taxels);
    begun.proportion = place(block, &at, 2 * taxels);
    begun.proportion_weight = place(block, &at, 2 * taxels);
    begun.stuck_last = place(block, &at, channels);
    begun.way = place(block, &at, channels);
    begun.began = place(block, &at, channels * sides);
    begun.n_good = place(block, &at, channels);
    begun.n_bad = place(block, &at, channels);
    begun.run = place(block, &at, channels);
    begun.n_turns = place(block, &at, channels);
    begun.relieved = place(block, &at, reals(2 * (size_t)taxels));
    begun.turns = place(block, &at, reals((size_t)(channels * (ptrdiff_t)with->stuck_history)));
    begun.noisy = place(block, &at, reals((size_t)channels));
    begun.stayed = place(block, &at, reals((size_t)channels));
    begun.readings = place(block, &at, channels);
    begun.pressed = place(block, &at, channels);
    begun.remainder = place(block, &at, channels);
    begun.details = place(block, &at, levels * channels);
    begun.bent = place(block, &at, 3 * taxels);
    begun.change = place(block, &at, channels);
    begun.usual = place(block, &at, taxels);
    begun.ok = place(block, &at, reals((size_t)channels));
    begun.stuck = place(block, &at, reals((size_t)channels));
    begun.jumped = place(block, &at, reals((size_t)channels));
    begun.jumps = place(block, &at, reals((size_t)channels));
    begun.is_taken = place(block, &at, reals((size_t)channels));
    begun.is_loaded = place(block, &at, reals((size_t)taxels));
    begun.was_relieved = place(block, &at, reals(2 * (size_t)taxels));
    if (block) {
        for (ptrdiff_t c = 0; c < channels; c++) {
            begun.floor_last[c] = NAN;
            begun.floor_step[c] = INFINITY;
            begun.floor_sd[c] = with->volts_per_step;
        }
        memcpy(block, &begun, sizeof begun);
        tactiled_readings_release((struct readings *)block);
    }
    return at;
}
