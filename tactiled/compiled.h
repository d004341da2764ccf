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

#endif
