/* Evidence and mechanics of the contact model: arrays in, arrays out, nothing kept here.
 *
 * `compiled.c` has the rules, which hold here too: every function does what numpy does beside its call, bit for
 * bit. Logarithms, exponentials and powers are those of the C library, which Python's `math` calls too
 * (`elementary.py`). In the mechanics the innermost loop runs over the friction hypotheses, whose results do not
 * mix, so that the compiler may take several at once; sums over taxels and rings add one term after the other, as
 * numpy's sums over a leading axis do.
 *
 * Arrays are dense, with the last index moving fastest. j counts hypotheses, t taxels, k rings.
 */
#include "compiled.h"

/* ---- friction and forecast (tactiled.detect.grip.friction, .forecast, .model) ---------------------------------- */

/* Take the ratio that the contact bears, and the largest one since it fell, before and now: `FrictionPosterior.bear`.
 * weights, met and penalty (n) are kept; `work` (n) is scratch.
 * `numbers`: least ratio, log of the ratio at the limit, logs over which it is met, log of the kinetic part, mean
 * duration of sliding, spread of the excess. */
void bear(ptrdiff_t n, const real *numbers, const real *log_friction, real *weights, real *met, real *penalty,
          real ratio, real before, real level, real step_s, real *work)
{
    const real log_ratio = log(at_least(ratio, numbers[0])), kept = exp(-step_s / numbers[4]);
    const real log_before = log(at_least(before, numbers[0])), log_level = log(at_least(level, numbers[0]));
    real most = -INFINITY, sum = 0, *found = work;
    int refutes = 0;
    for (ptrdiff_t j = 0; j < n; j++) {
        real above = log_ratio - log_friction[j], excess = at_least(above, 0) / numbers[5];
        real was_met = at_most(at_least((log_before - log_friction[j] - numbers[1]) / numbers[2] + 0.5, 0), 1);
        real is_met = at_most(at_least((log_level - log_friction[j] - numbers[1]) / numbers[2] + 0.5, 0), 1);
        real begins = at_least(is_met - was_met, 0) / at_least(1 - was_met, numbers[0]);
        real goes_on = above > numbers[3] ? met[j] * kept : 0;
        real more = at_least(0.5 * (excess * excess), penalty[j]);
        met[j] = goes_on + (1 - goes_on) * begins;
        refutes |= more > penalty[j];
        found[j] = penalty[j] - more;
        penalty[j] = more;
        most = at_least(found[j], most);
    }
    if (!refutes)
        return;
    for (ptrdiff_t j = 0; j < n; j++)
        sum += weights[j] *= exp(found[j] - most);
    for (ptrdiff_t j = 0; j < n; j++)
        weights[j] /= sum;
}

/* Quantile of log friction: where the weights (n) of cells from `lowest` on reach a part of their sum. */
static real log_quantile(ptrdiff_t n, const real *weights, real part, real lowest, real cell)
{
    real wanted = part * sum_of(n, weights), below = 0;
    ptrdiff_t j = 0;
    for (; j < n - 1 && below + weights[j] < wanted; j++)
        below += weights[j];
    return lowest + cell * ((real)j + (wanted - below) / at_least(weights[j], 1e-300));
}

/* Posterior after a scan: `ContactModel.grip`. weights, met, sticking and area (n); `work` (2, n) is scratch. out (12): utilisation,
 * friction, p_gross (three each), slipping share, p_sliding, p_incipient. Returns whether all slides. */
int posterior(ptrdiff_t n, const struct grip_numbers *with, const real *friction, const real *log_friction,
              const real *weights, const real *met, const real *sticking, const real *area, real size, real growth,
              real rate_sd, int is_fresh, int was_gross, real *out, real *work)
{
    real *sticks = work, *holds = work + n, slow[THREE], sliding = 0, stuck = 0, slides = 0, slipping = 0, incipient = 0;
    const real log_ratio = log(at_least(size, with->least_logged)), scale = at_least(size, with->least_ratio);
    for (ptrdiff_t j = 0; j < n; j++) {
        holds[j] = weights[j] * (1 - met[j]);
        sticks[j] = holds[j] * sticking[j];
        sliding += weights[j] * met[j];
        stuck += sticks[j];
    }
    for (ptrdiff_t j = 0; j < n; j++) {
        int partial = area[j] >= with->incipient_share ||
                      (is_fresh && growth > 0 && size > with->incipient_used * friction[j]);
        sticks[j] /= sliding + stuck;
        slides += weights[j] * met[j] / (sliding + stuck);
        slipping += sticks[j] * area[j];
        incipient += partial ? sticks[j] : 0;
    }
    int is_gross = slides > (was_gross ? with->gross_off : with->gross_on);
    const real *rests = is_gross ? sticks : holds;
    real mass = at_least(sum_of(n, rests), 1e-12);
    for (int k = 0; k < THREE; k++) {
        real tail = with->quantiles[k] / mass, part = at_most(at_least(1 - tail, 0), 1);
        real limit = exp(log_quantile(n, rests, part, with->lowest, with->cell));
        real rate = (growth / scale) + rate_sd / scale * with->rate_nodes[k];
        out[k] = tail >= 1 ? 1 : at_most(size / limit, 1);
        out[THREE + k] = exp(log_quantile(n, weights, with->quantiles[k], with->lowest, with->cell));
        out[2 * THREE + k] = 0;
        slow[k] = pow(at_least(rate, with->least_rate), -with->time_power);
    }
    for (ptrdiff_t j = 0; j < n; j++) {
        real log_used = log_ratio - log_friction[j] - with->log_full;
        real gap = pow(at_least(expm1(-log_used), with->least_gap), with->time_power);
        real arrives = holds[j] * exp(with->e_folds * at_most(log_used, 0));
        for (int k = 0; k < THREE; k++) {
            real in_time = 0;
            for (int node = 0; node < THREE; node++)
                in_time += with->node_weights[node] / (1 + gap * slow[node] * with->soon[k]);
            out[2 * THREE + k] += in_time * arrives;
        }
    }
    for (int k = 0; k < THREE; k++)
        out[2 * THREE + k] =
            at_most((is_fresh ? with->fresh : with->revisited) * out[2 * THREE + k] + with->unseen[k], 1);
    out[3 * THREE] = at_most(at_least(slides + slipping, 0), 1);
    out[3 * THREE + 1] = slides;
    out[3 * THREE + 2] = slides + incipient;
    return is_gross;
}

/* ---- changes of the shares (tactiled.detect.grip.wander) ------------------------------------------------------ */

/* Part of values (n) in an orthonormal basis (k, n) of at most `PATTERNS` vectors. */
static void project(ptrdiff_t n, ptrdiff_t k, const real *restrict basis, const real *restrict values,
                    real *restrict out)
{
    real along[PATTERNS];
    for (ptrdiff_t b = 0; b < k; b++)
        along[b] = dot(n, basis + b * n, values);
    for (ptrdiff_t i = 0; i < n; i++) {
        real sum = 0;
        for (ptrdiff_t b = 0; b < k; b++)
            sum += along[b] * basis[b * n + i];
        out[i] = sum;
    }
}

/* Log odds (hypotheses) of sliding from the changes of the shares: `ShareWander.log_odds`.
 *
 * measured (2 half, 2 taxels) and predicted (2 half, 2 taxels, hypotheses) of the looks so far are kept; `work`
 * (`WANDER_WORK`) is scratch. shear (2, taxels), expected (2, taxels, hypotheses) and the `whole`
 * load are those of this look; load and stiffness (taxels) are over it. `odds` stay as they are unless the looks
 * `can_tell`. */
void wander_odds(ptrdiff_t hypotheses, ptrdiff_t taxels, ptrdiff_t half, const struct wander_numbers *with,
                 const real *x, const real *y, real *measured, real *predicted, real *work, const real *shear,
                 const real *expected, real whole, const real *load, const real *stiffness, real *odds,
                 real noise_sd, int can_tell)
{
    const ptrdiff_t n = 2 * taxels, all = n * hypotheses, looks = 2 * half;
    real *basis = work, *change = work + PATTERNS * n, *part = change + n, *rest = part + n;
    real *pattern = rest + all, *along = pattern + PATTERNS * n, *square = along + PATTERNS * hypotheses;
    real *in_basis = square + hypotheses;
    memmove(measured, measured + n, octets((looks - 1) * n));
    memmove(predicted, predicted + all, octets((looks - 1) * all));
    for (ptrdiff_t i = 0; i < n; i++)
        measured[(looks - 1) * n + i] = shear[i] / whole;
    real *newest = predicted + (looks - 1) * all;
    for (ptrdiff_t i = 0; i < all; i++)
        newest[i] = expected[i] / whole;
    if (!can_tell)
        return;

    memset(pattern, 0, octets(PATTERNS * n));
    for (ptrdiff_t t = 0; t < taxels; t++) {
        real *x_of[PATTERNS], *y_of[PATTERNS];
        for (int p = 0; p < PATTERNS; p++) {
            x_of[p] = pattern + p * n + t;
            y_of[p] = x_of[p] + taxels;
        }
        real before_x = 0, before_y = 0;
        for (ptrdiff_t i = 0; i < half; i++) {
            before_x += measured[i * n + t];
            before_y += measured[i * n + taxels + t];
        }
        *x_of[0] = *y_of[2] = load[t];
        *x_of[1] = *y_of[3] = stiffness[t];
        *x_of[4] = -y[t] * stiffness[t];
        *y_of[4] = x[t] * stiffness[t];
        *x_of[5] = -y[t] * load[t];
        *y_of[5] = x[t] * load[t];
        *x_of[6] = *y_of[7] = before_x / (real)half;
        *y_of[6] = before_y / (real)half;
        *x_of[7] = -(before_y / (real)half);
    }
    ptrdiff_t rank = 0;
    for (int p = 0; p < PATTERNS; p++) {
        real *row = pattern + p * n, size = at_least(sqrt(dot(n, row, row)), with->least_norm);
        for (ptrdiff_t i = 0; i < n; i++)
            row[i] /= size;
        for (int twice = 0; twice < 2; twice++) {
            project(n, rank, basis, row, part);
            for (ptrdiff_t i = 0; i < n; i++)
                row[i] -= part[i];
        }
        size = sqrt(dot(n, row, row));
        if (size > with->same) {
            for (ptrdiff_t i = 0; i < n; i++)
                basis[rank * n + i] = row[i] / size;
            rank++;
        }
    }

    const real weight = 1 / (real)half;
    memset(change, 0, octets(n));
    memset(rest, 0, octets(all));
    for (ptrdiff_t k = 0; k < looks; k++) {
        real haar = k < half ? -weight : weight;
        for (ptrdiff_t i = 0; i < n; i++)
            change[i] += haar * measured[k * n + i];
        for (ptrdiff_t i = 0; i < all; i++)
            rest[i] += haar * predicted[k * all + i];
    }
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t j = 0; j < hypotheses; j++)
            rest[i * hypotheses + j] = change[i] - rest[i * hypotheses + j];
    project(n, rank, basis, change, part);
    real explained = with->leak * with->leak * (dot(n, part, part) / (real)n);
    real variance = 2 * (noise_sd * noise_sd) / (real)half + explained + with->least_variance;
    memset(along, 0, octets(rank * hypotheses));
    memset(square, 0, octets(hypotheses));
    for (ptrdiff_t b = 0; b < rank; b++)
        for (ptrdiff_t i = 0; i < n; i++)
            for (ptrdiff_t j = 0; j < hypotheses; j++)
                along[b * hypotheses + j] += basis[b * n + i] * rest[i * hypotheses + j];
    for (ptrdiff_t i = 0; i < n; i++) {
        memset(in_basis, 0, octets(hypotheses));
        for (ptrdiff_t b = 0; b < rank; b++)
            for (ptrdiff_t j = 0; j < hypotheses; j++)
                in_basis[j] += along[b * hypotheses + j] * basis[b * n + i];
        for (ptrdiff_t j = 0; j < hypotheses; j++) {
            real left = rest[i * hypotheses + j] - in_basis[j];
            square[j] += left * left;
        }
    }
    for (ptrdiff_t j = 0; j < hypotheses; j++) {
        real ratio = square[j] / (real)(n - rank) / variance;
        real found = with->slope * log(ratio + with->least_square) + with->offset;
        odds[j] = at_most(at_least(found, with->least), with->most);
    }
}

/* ---- evidence of the shares (tactiled.detect.grip.shares) ----------------------------------------------------- */

/* Forces of the taxels along their direction, over their limits, of one hypothesis. */
static WIDE void use(ptrdiff_t taxels, const struct shares_numbers *with, real friction, const real *restrict x,
                     const real *restrict y, const real *restrict load, real *restrict force, real *restrict used)
{
    const real tiny = with->tiny, least = with->least_used;
    for (ptrdiff_t t = 0; t < taxels; t++) {
        force[t] = at_least(sqrt(x[t] * x[t] + y[t] * y[t]), tiny);
        used[t] = at_most(at_least(force[t] / at_least(friction * load[t], tiny), least), 1);
    }
}

/* A look beside one hypothesis: residuals, the variance that is known of the nuisances, that of all (taxels), and the
 * covariance of the shear with the nuisances (5, taxels). `root` is the cubic root of what is left of the limit. Returns
 * the mean square of the residuals over their deviations. */
static WIDE real compare(ptrdiff_t taxels, const struct shares_numbers *with, real scale, real noise, real unexplained,
                         const real *restrict shear_x, const real *restrict shear_y, const real *restrict x,
                         const real *restrict y, const real *restrict load, const real *restrict force,
                         const real *restrict used, const real *restrict root, const real *restrict nuisance,
                         const real *restrict cov, real *restrict residual, real *restrict known,
                         real *restrict variance, real *restrict spread)
{
    const real power = with->power, even = with->even;
    real squares = 0;
    for (ptrdiff_t t = 0; t < taxels; t++) {
        real along = (shear_x[t] * x[t] + shear_y[t] * y[t]) / force[t], model = force[t] * scale;
        real softening = 1 - power * (1 - root[t] * root[t]) * root[t] / used[t];
        real to_x = x[t] / force[t], to_y = y[t] / force[t], moved = 0, own = 0;
        real direction[KINDS] = {model * to_x * to_x, model * to_y * to_y, model * softening, load[t] * to_x,
                                 load[t] * to_y};
        for (int a = 0; a < KINDS; a++) {
            real sum = 0;
            for (int b = 0; b < KINDS; b++)
                sum += cov[COV(a, b) * taxels + t] * direction[b];
            spread[a * taxels + t] = sum;
            moved += nuisance[a * taxels + t] * direction[a];
            own += sum * direction[a];
        }
        known[t] = own;
        variance[t] = own + (noise + unexplained * (even + (1 - even) * load[t]));
        residual[t] = along - (model + moved);
    }
    for (ptrdiff_t t = 0; t < taxels; t++)
        squares += residual[t] * residual[t] / variance[t];
    return squares / (real)taxels;
}

/* Nuisances (5, taxels) and the lower half of their covariance (15, taxels) after a look, of one hypothesis. Turns
 * `variance` into one over the likelihoods. */
static WIDE void learn(ptrdiff_t taxels, const struct shares_numbers *with, real size, real unmodelled, real temper,
                       const real *restrict residual, const real *restrict known, const real *restrict spread,
                       real *restrict variance, real *restrict nuisance, real *restrict cov)
{
    const real degrees = with->degrees;
    for (ptrdiff_t t = 0; t < taxels; t++) {
        real relative = residual[t] * residual[t] / variance[t] / unmodelled, all = variance[t] * unmodelled;
        real misfit = all - known[t], tail = 1 + relative / degrees;
        real precision = 1 / (known[t] + misfit / (temper * ((degrees + 1) / (degrees + relative))));
        variance[t] = tail * tail * sqrt(all) / size;
        for (int a = 0; a < KINDS; a++) {
            real gain = spread[a * taxels + t] * precision;
            nuisance[a * taxels + t] += gain * residual[t];
        }
        for (int a = 0; a < KINDS; a++)
            for (int b = 0; b <= a; b++)
                cov[COV(a, b) * taxels + t] -= spread[a * taxels + t] * spread[b * taxels + t] * precision;
    }
}

/* Log likelihoods (hypotheses) of a look that counts: `ShareEvidence._weigh`.
 *
 * nuisance (hypotheses, 5, taxels) and the lower half of their covariance (hypotheses, 15, taxels) are kept, so that
 * what is read together lies together. shear (2, taxels), predicted (2, hypotheses, taxels), borne (hypotheses), load
 * (taxels). `work` (`SHARES_WORK`) is scratch. */
void share_likelihoods(ptrdiff_t hypotheses, ptrdiff_t taxels, const struct shares_numbers *with,
                       const real *friction, real *nuisance, real *cov, const real *shear, const real *predicted,
                       const real *borne, const real *load, real *out, real size, real noise_sd, real unexplained,
                       real temper, real *work)
{
    const ptrdiff_t all = hypotheses * taxels;
    real *force = work, *used = force + taxels, *root = used + taxels, least = INFINITY;
    real *residual = root + taxels, *known = residual + all, *variance = known + all, *spread = variance + all;
    for (ptrdiff_t j = 0; j < hypotheses; j++) {
        const ptrdiff_t at = j * taxels;
        const real *x = predicted + at, *y = x + all;
        real scale = size / at_least(borne[j], with->tiny);
        if (fabs(scale - 1) < with->meets)
            scale = 1;
        use(taxels, with, friction[j], x, y, load, force, used);
        for (ptrdiff_t t = 0; t < taxels; t++)
            root[t] = cbrt(1 - used[t]);
        real square = compare(taxels, with, scale, noise_sd * noise_sd, unexplained, shear, shear + taxels, x, y, load,
                              force, used, root, nuisance + KINDS * at, cov + COVS * at, residual + at, known + at,
                              variance + at, spread + KINDS * at);
        least = at_most(square, least);
    }
    /* What no hypothesis explains is misfit of this look. */
    const real unmodelled = at_least(least, 1);
    for (ptrdiff_t j = 0; j < hypotheses; j++) {
        const ptrdiff_t at = j * taxels;
        real found = 0;
        learn(taxels, with, size, unmodelled, temper, residual + at, known + at, spread + KINDS * at, variance + at,
              nuisance + KINDS * at, cov + COVS * at);
        for (ptrdiff_t t = 0; t < taxels; t++)
            found += log(variance[at + t]);
        out[j] = -temper * found;
    }
}

/* ---- mechanics (tactiled.detect.grip.rings) ------------------------------------------------------------------ */

/* Forces along x and y of one ring of one taxel, for each hypothesis: move it, and shorten forces beyond the limit.
 *
 * bound (hypotheses) is the friction limit of the taxel; the ring has `limit` and `share` of its limit and
 * stiffness. Adds the forces to `sum_x` and `sum_y`, and to `sticking` the share where the ring sticks. */
static WIDE void move_ring(ptrdiff_t hypotheses, const real *restrict bound, real limit, real share, real below,
                           real tiny, real spring, const real *restrict step_x, const real *restrict step_y,
                           real *restrict force_x, real *restrict force_y, real *restrict sum_x, real *restrict sum_y,
                           real *restrict sticking)
{
    for (ptrdiff_t j = 0; j < hypotheses; j++) {
        real x = force_x[j] + spring * step_x[j], y = force_y[j] + spring * step_y[j];
        real cap = bound[j] * limit, size = sqrt(x * x + y * y);
        real kept = at_most(cap / at_least(size, tiny), 1);
        force_x[j] = x *= kept;
        force_y[j] = y *= kept;
        sum_x[j] += x;
        sum_y[j] += y;
        sticking[j] += size < below * cap ? share : 0;
    }
}

/* Bound and displacement of a taxel at (x, y) of this load, from the rigid motion. */
static WIDE void displace(ptrdiff_t hypotheses, const real *restrict friction, real load, real x, real y,
                          const real *restrict shift_x, const real *restrict shift_y, const real *restrict turn,
                          real *restrict bound, real *restrict step_x, real *restrict step_y)
{
    for (ptrdiff_t j = 0; j < hypotheses; j++) {
        bound[j] = friction[j] * load;
        step_x[j] = shift_x[j] - turn[j] * y;
        step_y[j] = shift_y[j] + turn[j] * x;
    }
}

/* Add a taxel's forces to the totals, and its tangent stiffness with moments to the six sums of `k`. */
static WIDE void add_taxel(ptrdiff_t hypotheses, real stiffness, real floor, real tiny, real x, real y,
                           const real *restrict force_x, const real *restrict force_y, const real *restrict sticking,
                           real *restrict total_x, real *restrict total_y, real *restrict moment, real *restrict k)
{
    const ptrdiff_t n = hypotheses;
    for (ptrdiff_t j = 0; j < n; j++) {
        real fx = force_x[j], fy = force_y[j];
        real lost = stiffness * (1 - at_least(sticking[j], floor)) / at_least(fx * fx + fy * fy, tiny);
        real xx = stiffness - lost * fx * fx, xy = -(lost * fx * fy), yy = stiffness - lost * fy * fy;
        real turned_x = x * xy - y * xx, turned_y = x * yy - y * xy;
        total_x[j] += fx;
        total_y[j] += fy;
        moment[j] += fy * x - fx * y;
        k[j] += xx;
        k[n + j] += xy;
        k[2 * n + j] += yy;
        k[3 * n + j] += turned_x;
        k[4 * n + j] += turned_y;
        k[5 * n + j] += x * turned_y - y * turned_x;
    }
}

/* Turn totals (x, y, moment) into the rigid motion towards those of `target`, in the same places.
 *
 * target: wanted totals, part of them that friction 1 bears, least stiffness against turns. */
static WIDE void solve(ptrdiff_t hypotheses, const real *restrict friction, real longest, real across, real tiny,
                       const real *restrict target, const real *restrict k, real *restrict x, real *restrict y,
                       real *restrict turn)
{
    const ptrdiff_t n = hypotheses;
    for (ptrdiff_t j = 0; j < n; j++) {
        real borne = at_most(friction[j] * target[3], 1), reach = friction[j] * longest;
        real lack_x = target[0] * borne - x[j], lack_y = target[1] * borne - y[j];
        real lack_m = target[2] * borne - turn[j];
        real kxx = k[j], kxy = k[n + j], kyy = k[2 * n + j], kx = k[3 * n + j], ky = k[4 * n + j];
        real det = at_least(kxx * kyy - kxy * kxy, tiny);
        real to_x = (kyy * kx - kxy * ky) / det, to_y = (kxx * ky - kxy * kx) / det;
        real angle = (lack_m - to_x * lack_x - to_y * lack_y)
                     / at_least(k[5 * n + j] - to_x * kx - to_y * ky, target[4]);
        real shift_x = (kyy * lack_x - kxy * lack_y) / det - to_x * angle;
        real shift_y = (kxx * lack_y - kxy * lack_x) / det - to_y * angle;
        real length = sqrt(shift_x * shift_x + shift_y * shift_y) + fabs(angle) * across;
        real part = at_most(reach / at_least(length, tiny), 1);
        x[j] = shift_x * part;
        y[j] = shift_y * part;
        turn[j] = angle * part;
    }
}

/* Forces of all taxels in n Newton steps towards the totals of `target` (see `solve`): `RingForces` explains them.
 *
 * x, y (taxels) are places; `rings` (2, rings) shares of stiffness and limit. `limits` has the floor of the stiffness,
 * the longest step, the extent of the places, the part of its limit below which a ring sticks, and the least divisor.
 * force (2, rings, taxels, hypotheses) is kept; sums (3, taxels, hypotheses) are the forces of the taxels and the
 * sticking shares of their stiffness. `work` (12, hypotheses) is scratch. */
void advance_rings(ptrdiff_t hypotheses, ptrdiff_t taxels, ptrdiff_t n_rings, const real *friction, const real *x,
                   const real *y, const real *rings, const real *limits, real *force, real *sums, real *work,
                   ptrdiff_t n_steps, const real *load, const real *stiffness, const real *target)
{
    const real floor = limits[0], longest = limits[1], across = limits[2], below = limits[3], tiny = limits[4];
    const ptrdiff_t n = hypotheses, all = taxels * n;
    real *shift_x = work, *shift_y = work + n, *turn = work + 2 * n;
    real *k = work + 3 * n, *bound = work + 9 * n, *step_x = work + 10 * n, *step_y = work + 11 * n;
    real *sum_x = sums, *sum_y = sums + all, *sticking = sums + 2 * all;
    real farthest = 0;
    for (ptrdiff_t t = 0; t < taxels; t++)
        farthest = at_least(load[t] / at_least(stiffness[t], tiny), farthest);
    memset(work, 0, octets(9 * n));
    for (ptrdiff_t step = 0;; step++) {
        memset(sums, 0, octets(3 * all));
        for (ptrdiff_t t = 0; t < taxels; t++) {
            displace(n, friction, load[t], x[t], y[t], shift_x, shift_y, turn, bound, step_x, step_y);
            for (ptrdiff_t r = 0; r < n_rings; r++)
                move_ring(n, bound, rings[n_rings + r], rings[r], below, tiny, stiffness[t] * rings[r], step_x,
                          step_y, force + r * all + t * n, force + (n_rings + r) * all + t * n, sum_x + t * n,
                          sum_y + t * n, sticking + t * n);
        }
        if (step == n_steps)
            return;
        memset(work, 0, octets(9 * n));
        for (ptrdiff_t t = 0; t < taxels; t++)
            add_taxel(n, stiffness[t], floor, tiny, x[t], y[t], sum_x + t * n, sum_y + t * n, sticking + t * n,
                      shift_x, shift_y, turn, k);
        solve(n, friction, longest * farthest, across, tiny, target, k, shift_x, shift_y, turn);
    }
}
