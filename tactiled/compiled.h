/* What the files of the compiled path share. `compiled.c` has the rules. */
#ifndef TACTILED_COMPILED_H
#define TACTILED_COMPILED_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define API __attribute__((visibility("default")))

/* Four numbers at once where the processor can, chosen when the library is loaded; with the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

typedef double real;
typedef uint8_t flag;

/* numpy's maximum and clip, which keep a value that is not a number. */
static inline real at_least(real value, real least) { return least > value ? least : value; }
static inline real at_most(real value, real most) { return most < value ? most : value; }

/* Sums in order. */
static inline real sum_of(ptrdiff_t n, const real *values)
{
    real sum = 0;
    for (ptrdiff_t j = 0; j < n; j++)
        sum += values[j];
    return sum;
}

static inline real dot(ptrdiff_t n, const real *a, const real *b)
{
    real sum = 0;
    for (ptrdiff_t i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* Octets of n reals, or of n numbers of the same size. Nothing here has an array of variable length: a thread may have a
 * stack of 128 kB, and an array 4096 taxels. What a function needs is in the block that its object was made in. */
static inline size_t octets(ptrdiff_t n) { return (size_t)n * sizeof(real); }

/* Number of reals that so many octets take, and the next n reals of a block; NULL where there is no block yet. */
static inline ptrdiff_t reals(size_t octets) { return (ptrdiff_t)((octets + sizeof(real) - 1) / sizeof(real)); }
static inline void *place(real *block, ptrdiff_t *at, ptrdiff_t n)
{
    *at += n;
    return block ? block + *at - n : NULL;
}

/* compiled.c */
int tactiled_hold(ptrdiff_t channels, real limit, real steps_per_volt, real *last, ptrdiff_t n, const real *volts,
                  const flag *valid, real *steps, flag *ok);
void tactiled_bank(ptrdiff_t channels, ptrdiff_t levels, const int64_t *lengths, const real *taps, ptrdiff_t n,
                   const real *newest, real *out);
int tactiled_stuck(ptrdiff_t channels, ptrdiff_t sides, ptrdiff_t history, const real *sign, const int64_t *others,
                   const flag *judged, real pressed, int64_t n_turned, int64_t n_long, real most_resting,
                   int64_t *position, real *last, real *way, int64_t *run, real *began, flag *turns, int64_t *n_turns,
                   flag *noisy, flag *stayed, ptrdiff_t n, const real *steps, flag *stuck);

/* compiled_grip.c */
/* Constants of `posterior`, in the order in which `ContactModel` and `forecast_numbers` have them. */
enum { THREE = 3 };
struct grip_numbers {
    real least_logged, log_full, lowest, cell, least_ratio, gross_on, gross_off, incipient_share, incipient_used;
    real quantiles[THREE];
    real least_rate, least_gap, time_power, e_folds, fresh, revisited;
    real rate_nodes[THREE], node_weights[THREE], soon[THREE], unseen[THREE];
};

enum { PATTERNS = 8 }; /* of a contact that holds, which `wander_odds` takes out */

/* Constants of `wander_odds`, in the order in which `ShareWander` has them. */
struct wander_numbers {
    real least_norm, same, leak, least_variance, least_square, slope, offset, least, most;
};

/* Constants of `share_likelihoods`, in the order in which `ShareEvidence` has them. */
struct shares_numbers {
    real tiny, meets, least_used, power, even, degrees;
};

enum { KINDS = 5 }; /* of nuisances: gains of shear along x and y, softening, offsets along x and y */
enum { COVS = KINDS * (KINDS + 1) / 2 }; /* entries of the lower half of their covariance, and the place of one */
#define COV(a, b) ((a) > (b) ? (a) * ((a) + 1) / 2 + (b) : (b) * ((b) + 1) / 2 + (a))

/* Reals of scratch that `wander_odds` and `share_likelihoods` need. */
#define WANDER_WORK(m, n) (2 * (n) * (2 * PATTERNS + 2 + (m)) + (PATTERNS + 2) * (m))
#define SHARES_WORK(m, n) (3 * (n) + (KINDS + 3) * (m) * (n))

void bear(ptrdiff_t n, const real *numbers, const real *log_friction, real *weights, real *met, real *penalty,
          real ratio, real before, real level, real step_s, real *work);
int posterior(ptrdiff_t n, const struct grip_numbers *with, const real *friction, const real *log_friction,
              const real *weights, const real *met, const real *sticking, const real *area, real size, real growth,
              real rate_sd, int is_fresh, int was_gross, real *out, real *work);
void wander_odds(ptrdiff_t hypotheses, ptrdiff_t taxels, ptrdiff_t half, const struct wander_numbers *with,
                 const real *x, const real *y, real *measured, real *predicted, real *work, const real *shear,
                 const real *expected, real whole, const real *load, const real *stiffness, real *odds,
                 real noise_sd, int can_tell);
void share_likelihoods(ptrdiff_t hypotheses, ptrdiff_t taxels, const struct shares_numbers *with,
                       const real *friction, real *nuisance, real *cov, const real *shear, const real *predicted,
                       const real *borne, const real *load, real *out, real size, real noise_sd, real unexplained,
                       real temper, real *work);
void advance_rings(ptrdiff_t hypotheses, ptrdiff_t taxels, ptrdiff_t n_rings, const real *friction, const real *x,
                   const real *y, const real *rings, const real *limits, real *force, real *sums, real *work,
                   ptrdiff_t n_steps, const real *load, const real *stiffness, const real *target);

#endif
