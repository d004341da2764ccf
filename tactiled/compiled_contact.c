/* One contact of the contact model, scan by scan (tactiled.detect.grip.model), with its state in one block.
 *
 * `compiled.c` and `compiled_grip.c` have the rules. The caller allocates the block, which stays in place, and hands
 * it to every call.
 */
#include "compiled.h"

/* Newest values, oldest first, from `begin` to `end`; they move to the front when the end of the room is reached. */
struct window {
    ptrdiff_t begin, end, room;
    real *values;
};

static ptrdiff_t count(const struct window *window) { return window->end - window->begin; }

static void append(struct window *window, real value)
{
    if (count(window) == window->room)
        window->begin++;
    if (window->end == window->room) {
        window->end -= window->begin;
        memmove(window->values, window->values + window->begin, octets(window->end));
        window->begin = 0;
    }
    window->values[window->end++] = value;
}

static real length(const real *v) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

/* Constants and state of `Trend`. */
struct trend_numbers {
    real density, average_s, start_rate_sd, before_s, least_noise, least_size;
};
struct trend {
    real value[3], rate[3], fast_rate[3], vv, vr, rr, value_sd, rate_sd, size, growth, largest;
    ptrdiff_t is_begun, is_fresh;
    struct window recent;
};

/* Take the ratio (3) of a scan: `Trend.step`. */
static void follow_trend(const struct trend_numbers *with, struct trend *trend, const real *ratio, real noise_sd,
                         real step_s)
{
    const real sd = at_least(noise_sd, with->least_noise), noise = sd * sd;
    if (!trend->is_begun) {
        trend->is_begun = 1;
        memcpy(trend->value, ratio, sizeof trend->value);
        trend->size = length(ratio);
        trend->vv = noise;
        trend->vr = 0;
        trend->rr = with->start_rate_sd * with->start_rate_sd;
        trend->value_sd = sqrt(noise);
        return;
    }
    const real h = step_s, q = with->density;
    const real vv = trend->vv + 2 * h * trend->vr + h * h * trend->rr + q * (h * h * h) / 3;
    const real vr = trend->vr + h * trend->rr + q * h * h / 2, rr = trend->rr + q * h;
    const real gain = vv / (vv + noise), rate_gain = vr / (vv + noise), part = 1 - exp(-h / with->average_s);
    real along = 0;
    for (int k = 0; k < 3; k++) {
        real predicted = trend->value[k] + h * trend->fast_rate[k], off = ratio[k] - predicted;
        trend->value[k] = predicted + gain * off;
        trend->fast_rate[k] += rate_gain * off;
        trend->rate[k] += part * (trend->fast_rate[k] - trend->rate[k]);
        along += trend->value[k] * trend->rate[k];
    }
    trend->vv = (1 - gain) * vv;
    trend->vr = (1 - gain) * vr;
    trend->rr = rr - rate_gain * vr;
    trend->size = length(trend->value);
    trend->value_sd = sqrt(trend->vv);
    const real memory_s = h / at_least(gain, with->least_size);
    trend->rate_sd = sqrt(trend->rr * memory_s / (memory_s + with->average_s));
    trend->growth = along / at_least(at_least(trend->size, trend->value_sd), with->least_size);
    trend->largest = at_least(trend->size, trend->largest);
    append(&trend->recent, trend->largest);
    while ((real)count(&trend->recent) > rint(with->before_s / h) + 1)
        trend->recent.begin++;
    trend->is_fresh = trend->size > trend->recent.values[trend->recent.begin];
}

/* Constants and state of `GrowthEvidence`. */
struct growth_numbers {
    real history_s, half, slows, nearly, stays, least, noisy, turn, noises, few;
    real hand_s, hand_log_sd, rare, slide[2], even[2], smooth[2], other, stays_at;
};
struct growth {
    real taken;
    ptrdiff_t n, taken_at;
    struct window sizes;
};

static void take_size(const struct growth_numbers *with, struct growth *growth, real size, real step_s)
{
    growth->n++;
    append(&growth->sizes, size);
    if ((real)count(&growth->sizes) > with->history_s / step_s)
        growth->sizes.begin++;
}

/* Scan, between two, at which a growth (n) first comes to a value; its end if it does not. */
static real crossing(ptrdiff_t n, const real *rise, real value)
{
    for (ptrdiff_t k = 0; k < n; k++)
        if (rise[k] >= value)
            return k ? (real)(k - 1) + (value - rise[k - 1]) / (rise[k] - rise[k - 1]) : 0;
    return (real)(n - 1);
}

/* Normal density of a mean and an sd, up to the factor that all have. */
static real density(real value, const real *normal)
{
    real z = (value - normal[0]) / normal[1];
    return exp(-0.5 * (z * z)) / normal[1];
}

/* Log odds of a growth (n) from half of the level; NaN while the ratio does not stay. `total` (n + 1) is scratch. */
static real odds_of_growth(const struct growth_numbers *with, ptrdiff_t n, const real *rise, real level, real size_sd,
                           real step_s, real *total)
{
    const real half = step_s * crossing(n, rise, with->half * level);
    const real slows = step_s * crossing(n, rise, with->slows * level);
    const real nearly = step_s * crossing(n, rise, with->nearly * level);
    const real stays = step_s * crossing(n, rise, with->stays * level);
    const real stayed_s = step_s * (real)(n - 1) - nearly, took_s = at_least(nearly - half, step_s);
    const real noise = with->noises * size_sd / (with->turn * level);
    const real averaged = at_least(ceil(noise * noise), 1);
    if (stayed_s < at_least(at_least(averaged, 2) * step_s, took_s))
        return NAN;
    real largest = -INFINITY, largest_mean = -INFINITY, mean = 0;
    total[0] = 0;
    for (ptrdiff_t k = 0; k < n; k++) {
        largest = at_least(rise[k], largest);
        total[k + 1] = total[k] + rise[k];
    }
    for (ptrdiff_t k = 0, m = (ptrdiff_t)averaged; k <= n - m; k++) {
        mean = (total[k + m] - total[k]) / averaged;
        largest_mean = at_least(mean, largest_mean);
    }
    const real fell = at_least(largest_mean - mean - with->turn * level, largest - level - with->noises * size_sd);
    if (fell > with->turn * level)
        return NAN;
    const real z = log(took_s / with->hand_s) / with->hand_log_sd;
    real found = with->stays_at - log(at_least(0.5 * (1 + erf(z / sqrt(2.0))), with->rare));
    if (slows - half >= with->few * step_s) {
        real course = log(at_least(stays - slows, 0.5 * step_s) / (0.2 * (slows - half)));
        real holds = 0.5 * (density(course, with->even) + density(course, with->smooth));
        found += log((density(course, with->slide) + with->other) / (holds + with->other));
    }
    return found;
}

/* Log odds of sliding that are new: `GrowthEvidence.log_odds`. */
static real growth_odds(const struct growth_numbers *with, struct growth *growth, real size_sd, real step_s,
                        real *work)
{
    const ptrdiff_t n = count(&growth->sizes);
    if (n == 0)
        return 0;
    const real *sizes = growth->sizes.values + growth->sizes.begin;
    const real level = n > 1 ? (sizes[n - 2] + sizes[n - 1]) / 2 : sizes[n - 1];
    ptrdiff_t below = n - 1;
    while (below >= 0 && !(sizes[below] < with->half * level))
        below--;
    if (below < 0 || level < at_least(size_sd / with->noisy, with->least))
        return 0;
    const real found = odds_of_growth(with, n - below, sizes + below, level, size_sd, step_s, work);
    if (isnan(found))
        return 0;
    if (growth->n - n + below >= growth->taken_at) {
        growth->taken = 0;
        growth->taken_at = growth->n;
    }
    const real more = found - growth->taken;
    growth->taken = found;
    return more;
}

/* Constants and state of `ShareEvidence`: places are ratios (n, 3) at which a look was taken. */
struct places_numbers {
    real gain_sd, common, softening_sd, offset_sd, unlike, least_uneven;
    real place, noisy, grown, least_ratio, noises, loaded, misfit, temper, n_places;
    struct shares_numbers shares;
};
struct places {
    real uneven, largest, *places, *nuisance, *cov;
    ptrdiff_t n;
};

/* Set the spread of the nuisances, from how uneven the loads are: `ShareEvidence._begin`. `logs` (taxels) is scratch. */
static void begin_shares(const struct places_numbers *with, struct places *shares, ptrdiff_t hypotheses,
                         ptrdiff_t taxels, const real *part_of_load, real *logs)
{
    real mean = 0, square = 0, spread = with->unlike;
    ptrdiff_t n = 0;
    for (ptrdiff_t t = 0; t < taxels; t++)
        if (part_of_load[t] > with->loaded)
            mean += logs[n++] = log(part_of_load[t]);
    mean /= (real)n;
    for (ptrdiff_t t = 0; t < n; t++)
        square += (logs[t] - mean) * (logs[t] - mean);
    if (n > 1)
        spread = sqrt(square / (real)n);
    shares->uneven = at_least(at_most(spread / with->unlike, 1), with->least_uneven);
    const real softening_sd = with->softening_sd * shares->uneven, offset_sd = with->offset_sd * shares->uneven;
    const real sd[KINDS] = {with->gain_sd, with->gain_sd, softening_sd, offset_sd, offset_sd};
    for (ptrdiff_t j = 0; j < hypotheses; j++)
        for (ptrdiff_t t = 0; t < taxels; t++) {
            real *cov = shares->cov + j * COVS * taxels + t;
            for (int k = 0; k < KINDS; k++)
                cov[COV(k, k) * taxels] = sd[k] * sd[k];
            cov[COV(0, 1) * taxels] = with->common * with->gain_sd * with->gain_sd;
        }
}

/* Weight of a look at a ratio (3) of this size, 0 where it says nothing new; sets the misfit. */
static real look_weight(const struct places_numbers *with, struct places *shares, const real *ratio, real size,
                        real noise_sd, real unexplained)
{
    real nearest = INFINITY;
    for (ptrdiff_t i = 0; i < (ptrdiff_t)with->n_places; i++) {
        const real *place = shares->places + 3 * i;
        real off[3] = {place[0] - ratio[0], place[1] - ratio[1], place[2] - ratio[2]};
        nearest = at_most(off[0] * off[0] + off[1] * off[1] + off[2] * off[2], nearest);
    }
    const real within = with->place * size;
    if (!(nearest < within * within)) {
        memcpy(shares->places + 3 * (shares->n++ % (ptrdiff_t)with->n_places), ratio, sizeof(real[3]));
        return with->temper;
    }
    const real noise = noise_sd * noise_sd, part = noise / (noise + unexplained);
    return part < with->noisy ? 0 : with->temper * part;
}

/* Constants of a contact, in the order in which `contact_numbers` has them. */
struct contact_numbers {
    struct trend_numbers trend;
    struct {
        real numbers[6], fallen, least_weight;
    } bear;
    struct growth_numbers growth;
    struct {
        real limits[5], n_steps, reached, least_turn;
    } rings;
    struct places_numbers places;
    struct wander_numbers wander;
    real diffusion, tiny, surely;
    struct grip_numbers grip;
};

enum { OUT = 12 };

/* State of a contact at the beginning of a block; what its pointers point to lies behind it, except for the constants
 * and for the arrays of the friction posterior, which outlives the contact. */
struct contact {
    struct {
        real total[3], ratio[3], ratio_sd, rate_sd, size, growth, is_fresh;
        real posterior[OUT], is_gross, is_unloading, log_odds;
    } seen; /* what the caller reads */
    struct trend trend;
    struct growth growth;
    struct places shares;
    real scan_s, noise_sd, borne; /* largest ratio since it fell */
    ptrdiff_t n_looks, hypotheses, taxels, n_rings, half;
    const struct contact_numbers *with;
    const real *x, *y, *ring_shares, *friction, *log_friction, *walk_rates, *newest, *parts;
    real *weights, *met, *penalty, *shear;
    real *force, *sums, *measured, *predicted, *expected, *work;
    real *odds, *sticking, *area; /* by hypothesis */
    real *part;                   /* of the load, by taxel */
    real *smooth, *smooth_shear, *load, *stiffness, *over_mean, *sizes, *likely; /* of one look */
};

/* Totals (3) of shears (2, taxels): sums along x and y, and moment. */
static void total_of(const struct contact *c, const real *shear, real *total)
{
    const ptrdiff_t n = c->taxels;
    total[0] = sum_of(n, shear);
    total[1] = sum_of(n, shear + n);
    total[2] = dot(n, shear + n, c->x) - dot(n, shear, c->y);
}

/* Take the newest loads and shears, whose loads sum to `whole`: `ContactModel.measure`. */
API void tactiled_model_measure(struct contact *c, real whole)
{
    const ptrdiff_t n = c->taxels;
    const real *load = c->newest, *shear = c->newest + n;
    for (ptrdiff_t i = 0; i < 2 * n; i++)
        c->shear[i] = shear[i] - c->parts[i] * load[i % n];
    total_of(c, c->shear, c->seen.total);
    for (ptrdiff_t i = 0; i < 2 * n; i++)
        c->shear[i] /= whole;
}

/* Measure, and follow the ratio of the total to its load: `ContactModel.follow`. */
API void tactiled_model_follow(struct contact *c, real whole, real noise_sd, real step_s, real offset_sd)
{
    const struct trend *trend = &c->trend;
    tactiled_model_measure(c, whole);
    const real ratio[3] = {c->seen.total[0] / whole, c->seen.total[1] / whole, c->seen.total[2] / whole};
    follow_trend(&c->with->trend, &c->trend, ratio, noise_sd, step_s);
    memcpy(c->seen.ratio, trend->value, sizeof trend->value);
    c->seen.ratio_sd = trend->value_sd;
    c->seen.rate_sd = trend->rate_sd;
    c->seen.size = trend->size;
    c->seen.growth = trend->growth;
    c->seen.is_fresh = (real)trend->is_fresh;
    const real borne = at_least(trend->size - c->with->surely * offset_sd, 0), before = c->borne;
    c->borne = at_most(borne / c->with->bear.fallen, at_least(borne, before));
    bear(c->hypotheses, c->with->bear.numbers, c->log_friction, c->weights, c->met, c->penalty, borne, before,
         c->borne, step_s, c->work);
    take_size(&c->with->growth, &c->growth, length(ratio), step_s);
    c->scan_s = step_s;
    c->noise_sd = noise_sd;
}

/* Multiply the weights by likelihoods given as logarithms: `FrictionPosterior.take`. */
static void weigh(ptrdiff_t n, real *weights, const real *log_likelihood)
{
    real most = -INFINITY, sum = 0;
    for (ptrdiff_t j = 0; j < n; j++)
        most = at_least(log_likelihood[j], most);
    for (ptrdiff_t j = 0; j < n; j++)
        sum += weights[j] *= exp(log_likelihood[j] - most);
    for (ptrdiff_t j = 0; j < n; j++)
        weights[j] /= sum;
}

/* Take log odds of sliding that are the same for all friction values: `FrictionPosterior.take_sliding`. */
static void take_sliding(struct contact *c, real log_odds)
{
    const real times = exp(log_odds);
    const ptrdiff_t n = c->hypotheses;
    for (ptrdiff_t j = 0; j < n; j++) {
        real slides = c->weights[j] * c->met[j] * times, weight = slides + c->weights[j] * (1 - c->met[j]);
        c->met[j] = slides / at_least(weight, c->with->bear.least_weight);
        c->weights[j] = weight;
    }
    const real sum = sum_of(n, c->weights);
    for (ptrdiff_t j = 0; j < n; j++)
        c->weights[j] /= sum;
}

/* Let friction change, with rates (2, n - 1): `FrictionPosterior._diffuse`. `flow` (n) is scratch. */
static void diffuse(ptrdiff_t n, real *weights, const real *rates, real part, real *flow)
{
    const real steps = at_least(rint(part / 0.25), 1);
    for (real step = 0; step < steps; step++) {
        for (ptrdiff_t j = 0; j < n - 1; j++)
            flow[j] = part / steps * (rates[n - 1 + j] * weights[j + 1] - rates[j] * weights[j]);
        for (ptrdiff_t j = 0; j < n - 1; j++)
            weights[j] += flow[j];
        for (ptrdiff_t j = 0; j < n - 1; j++)
            weights[j + 1] -= flow[j];
    }
}

/* Weight the friction values by how the taxels share the shear: `ShareEvidence.log_likelihood`.
 *
 * shear (2, taxels) and predicted (2, hypotheses, taxels) over the mean load, as `part_of_load`; ratio (3) and borne
 * (hypotheses) over the whole load. */
static void take_shares(struct contact *c, const real *shear, const real *predicted, const real *borne,
                        const real *part_of_load, const real *ratio, real noise_sd)
{
    const struct places_numbers *with = &c->with->places;
    const ptrdiff_t n = c->taxels, m = c->hypotheses;
    struct places *shares = &c->shares;
    const real size = length(ratio);
    shares->largest = at_least(size, shares->largest);
    if (size < with->least_ratio || size < with->noises * noise_sd / sqrt((real)n) ||
        size < with->grown * shares->largest)
        return;
    if (shares->uneven == 0)
        begin_shares(with, shares, m, n, part_of_load, c->work);
    const real misfit = with->misfit * shares->uneven * size, unexplained = misfit * misfit;
    const real temper = look_weight(with, shares, ratio, size, noise_sd, unexplained);
    if (temper == 0)
        return;
    share_likelihoods(m, n, &with->shares, c->friction, shares->nuisance, shares->cov, shear, predicted, borne,
                      part_of_load, c->likely, size, noise_sd, unexplained, temper, c->work);
    weigh(m, c->weights, c->likely);
}

/* Lengths (hypotheses) of the totals of the forces of the taxels, and the shares of the area that slip. `work`
 * (4, hypotheses) is scratch. */
static WIDE void total_forces(ptrdiff_t taxels, ptrdiff_t hypotheses, const real *restrict x, const real *restrict y,
                              const real *restrict part, const real *restrict sums, real *restrict size,
                              real *restrict area, real *restrict work)
{
    const ptrdiff_t n = taxels, m = hypotheses, all = n * m;
    real *total_x = work, *total_y = work + m, *turned_x = work + 2 * m, *turned_y = work + 3 * m;
    for (ptrdiff_t j = 0; j < m; j++)
        total_x[j] = total_y[j] = turned_x[j] = turned_y[j] = area[j] = 0;
    for (ptrdiff_t t = 0; t < n; t++)
        for (ptrdiff_t j = 0; j < m; j++) {
            const real force_x = sums[t * m + j], force_y = sums[all + t * m + j];
            total_x[j] += force_x;
            total_y[j] += force_y;
            turned_x[j] += force_x * y[t];
            turned_y[j] += force_y * x[t];
            area[j] += (1 - sums[2 * all + t * m + j]) * part[t];
        }
    for (ptrdiff_t j = 0; j < m; j++) {
        const real moment = turned_y[j] - turned_x[j], sticks = 1 - area[j];
        size[j] = sqrt(total_x[j] * total_x[j] + total_y[j] * total_y[j] + moment * moment);
        area[j] = 1 - sticks * sticks;
    }
}

/* Look at the shares of the taxels, in the approximation by a filter whose newest tap comes first:
 * `ContactModel.look`. */
API void tactiled_model_look(struct contact *c, ptrdiff_t n_taps, const real *taps, real noise_sd, real step_s)
{
    const struct contact_numbers *with = c->with;
    const ptrdiff_t n = c->taxels, m = c->hypotheses, all = n * m;
    real *smooth = c->smooth, *shear = c->smooth_shear, *load = c->load, *stiffness = c->stiffness;
    real *over_mean = c->over_mean, *borne = c->sizes, total[3], ratio[3];
    memset(smooth, 0, octets(3 * n));
    for (ptrdiff_t k = n_taps - 1; k >= 0; k--)
        for (ptrdiff_t i = 0; i < 3 * n; i++)
            smooth[i] += taps[k] * c->newest[i - 3 * n * k];
    for (ptrdiff_t t = 0; t < n; t++) {
        load[t] = at_least(smooth[t], 0);
        stiffness[t] = cbrt(load[t]);
        shear[t] = smooth[n + t] - c->parts[t] * smooth[t];
        shear[n + t] = smooth[2 * n + t] - c->parts[n + t] * smooth[t];
    }
    const real sum = sum_of(n, load), whole = at_least(sum, with->tiny), mean = whole / (real)n;
    total_of(c, shear, total);
    const real bearable = with->rings.reached * sum / at_least(length(total), with->rings.limits[4]);
    const real least_turn = at_least(with->rings.least_turn * sum_of(n, stiffness), with->rings.limits[4]);
    const real target[5] = {total[0], total[1], total[2], bearable, least_turn};
    advance_rings(m, n, c->n_rings, c->friction, c->x, c->y, c->ring_shares, with->rings.limits, c->force, c->sums,
                  c->work, (ptrdiff_t)with->rings.n_steps, load, stiffness, target);

    for (ptrdiff_t t = 0; t < n; t++) {
        c->part[t] = load[t] / whole;
        stiffness[t] = cbrt(c->part[t]);
        over_mean[t] = load[t] / mean;
        over_mean[n + t] = shear[t] / mean;
        over_mean[2 * n + t] = shear[n + t] / mean;
        for (ptrdiff_t j = 0; j < m; j++) {
            c->expected[j * n + t] = c->sums[t * m + j] / mean;
            c->expected[all + j * n + t] = c->sums[all + t * m + j] / mean;
        }
    }
    for (int k = 0; k < 3; k++)
        ratio[k] = total[k] / whole;
    total_forces(n, m, c->x, c->y, c->part, c->sums, borne, c->area, c->work);
    for (ptrdiff_t j = 0; j < m; j++)
        borne[j] /= whole;
    take_shares(c, over_mean + n, c->expected, borne, over_mean, ratio, noise_sd / mean);

    memset(c->odds, 0, octets(m));
    c->n_looks++;
    wander_odds(m, n, c->half, &with->wander, c->x, c->y, c->measured, c->predicted, c->work, shear, c->sums, whole,
                c->part, stiffness, c->odds, noise_sd / whole, c->n_looks >= 2 * c->half && 2 * n > PATTERNS);
    const real grew = growth_odds(&with->growth, &c->growth, c->noise_sd, c->scan_s, c->work);
    if (grew != 0)
        take_sliding(c, grew);
    diffuse(m, c->weights, c->walk_rates, with->diffusion * step_s, c->work);
    for (ptrdiff_t j = 0; j < m; j++)
        c->sticking[j] = exp(-c->odds[j]);
}

/* Posterior of the newest scan: `ContactModel.grip`. */
API void tactiled_model_grip(struct contact *c)
{
    const struct trend *trend = &c->trend;
    c->seen.is_gross = posterior(c->hypotheses, &c->with->grip, c->friction, c->log_friction, c->weights, c->met,
                                 c->sticking, c->area, trend->size, trend->growth, trend->rate_sd,
                                 (int)trend->is_fresh, c->seen.is_gross > 0, c->seen.posterior, c->work);
    c->seen.is_unloading = trend->growth < -2 * trend->rate_sd;
    c->seen.log_odds = dot(c->hypotheses, c->weights, c->odds);
}

/* Begin all windows anew after a gap: `ContactModel.skip`. */
API void tactiled_model_skip(struct contact *c)
{
    struct growth *growth = &c->growth;
    growth->sizes.begin = growth->sizes.end = 0;
    growth->taken = 0;
    growth->n = 0;
    growth->taken_at = -1;
    c->n_looks = 0;
}

/* Taxels of which a tenth or more slips: `ContactModel.slipping_taxels`. */
API void tactiled_model_taxels(const struct contact *c, uint8_t *slips)
{
    const ptrdiff_t n = c->taxels, m = c->hypotheses;
    for (ptrdiff_t t = 0; t < n; t++) {
        real share = 0;
        for (ptrdiff_t j = 0; j < m; j++)
            share += c->weights[j] * (1 - c->sums[(2 * n + t) * m + j]);
        slips[t] = 1 - (1 - share) * (1 - share) >= c->with->grip.incipient_share && c->part[t] > 0;
    }
}

static struct window window_of(real *block, ptrdiff_t *at, real n)
{
    const ptrdiff_t room = 2 * ((ptrdiff_t)n + 3);
    return (struct window){0, 0, room, place(block, at, room)};
}

/* Begin a contact in a block of zeros, and return the number of reals that it takes; with no block, return the number
 * only. `step_s` is the time between scans. */
API ptrdiff_t tactiled_model(ptrdiff_t hypotheses, ptrdiff_t taxels, ptrdiff_t n_rings, ptrdiff_t half, real step_s,
                             const struct contact_numbers *with, const real *x, const real *y,
                             const real *ring_shares, const real *friction, const real *log_friction,
                             const real *walk_rates, real *weights, real *met, real *penalty, const real *newest,
                             const real *parts, real *shear, real *block)
{
    const ptrdiff_t m = hypotheses, n = taxels, all = m * n, n_places = (ptrdiff_t)with->places.n_places;
    struct contact begun = {.hypotheses = m, .taxels = n, .n_rings = n_rings, .half = half, .with = with, .x = x,
                            .y = y, .ring_shares = ring_shares, .friction = friction, .log_friction = log_friction,
                            .walk_rates = walk_rates, .weights = weights, .met = met, .penalty = penalty,
                            .newest = newest, .parts = parts, .shear = shear};
    ptrdiff_t at = reals(sizeof begun);
    begun.trend.value_sd = begun.seen.ratio_sd = INFINITY;
    begun.trend.rate_sd = begun.seen.rate_sd = with->trend.start_rate_sd;
    begun.trend.is_fresh = 1;
    begun.seen.is_fresh = 1;
    begun.growth.taken_at = -1;
    begun.trend.recent = window_of(block, &at, with->trend.before_s / step_s);
    begun.growth.sizes = window_of(block, &at, with->growth.history_s / step_s);
    begun.shares.places = place(block, &at, 3 * n_places);
    begun.shares.nuisance = place(block, &at, KINDS * all);
    begun.shares.cov = place(block, &at, COVS * all);
    begun.force = place(block, &at, 2 * n_rings * all);
    begun.sums = place(block, &at, 3 * all);
    begun.measured = place(block, &at, 4 * half * n);
    begun.predicted = place(block, &at, 4 * half * all);
    begun.expected = place(block, &at, 2 * all);
    /* Whoever needs scratch begins at its front, so that it has the room of the largest. */
    ptrdiff_t room = begun.growth.sizes.room + 1;
    const ptrdiff_t others[] = {WANDER_WORK(m, n), SHARES_WORK(m, n), 12 * m, n};
    for (size_t i = 0; i < sizeof others / sizeof *others; i++)
        room = others[i] > room ? others[i] : room;
    begun.work = place(block, &at, room);
    begun.odds = place(block, &at, m);
    begun.sticking = place(block, &at, m);
    begun.area = place(block, &at, m);
    begun.part = place(block, &at, n);
    begun.smooth = place(block, &at, 3 * n);
    begun.smooth_shear = place(block, &at, 2 * n);
    begun.load = place(block, &at, n);
    begun.stiffness = place(block, &at, n);
    begun.over_mean = place(block, &at, 3 * n);
    begun.sizes = place(block, &at, m);
    begun.likely = place(block, &at, m);
    if (block) {
        for (ptrdiff_t i = 0; i < 3 * n_places; i++)
            begun.shares.places[i] = INFINITY;
        for (ptrdiff_t j = 0; j < m; j++)
            begun.sticking[j] = 1;
        for (ptrdiff_t t = 0; t < n; t++)
            begun.part[t] = 1 / (real)n;
        for (ptrdiff_t i = 0; i < all; i++)
            begun.sums[2 * all + i] = 1;
        memcpy(block, &begun, sizeof begun);
    }
    return at;
}

/* Forget how large the gains of some taxels are: `ShareEvidence.loosen`. */
API void tactiled_model_loosen(struct contact *c, const uint8_t *taxels)
{
    const ptrdiff_t n = c->taxels;
    const real sd = c->with->places.gain_sd * c->shares.uneven;
    if (c->shares.uneven == 0)
        return;
    for (ptrdiff_t j = 0; j < c->hypotheses; j++)
        for (ptrdiff_t t = 0; t < n; t++)
            for (int axis = 0; taxels[t] && axis < 2; axis++)
                c->shares.cov[(j * COVS + COV(axis, axis)) * n + t] += sd * sd;
}
