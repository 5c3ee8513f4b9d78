/* One number of each of eight stretches side by side, which the compiler turns into vector instructions. */
#ifndef LANES_H
#define LANES_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif

/* Compiled twice by GCC, for CPUs with AVX-512 too; sums are rounded alike by both. */
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__)
#define CLONED __attribute__((flatten, target_clones("avx512f", "default")))
#else
#define CLONED
#endif

/* For functions that are compiled once for each order of motion. */
#define INLINE inline __attribute__((always_inline))

enum { LANES = 8 };

typedef double lanes __attribute__((vector_size(64), aligned(8)));
typedef int64_t mask __attribute__((vector_size(64), aligned(8)));

static inline lanes all(double x) { return (lanes){x, x, x, x, x, x, x, x}; }

static inline lanes pick(mask m, lanes a, lanes b) { return (lanes)(((mask)a & m) | ((mask)b & ~m)); }

static inline int any(mask m)
{
    int64_t found = 0;
    for (int w = 0; w < LANES; w++)
        found |= m[w];
    return found != 0;
}

static inline lanes root(lanes v)
{
    for (int w = 0; w < LANES; w++)
        v[w] = sqrt(v[w]);
    return v;
}

static inline lanes logarithm(lanes v)
{
    for (int w = 0; w < LANES; w++)
        v[w] = log(v[w]);
    return v;
}

/* Where eight stretches stand in the last axis of an array; -1: nowhere. */
struct place {
    int whole; /* one after the other */
    int64_t at[LANES];
};

static inline lanes load(const double *row, const struct place *p)
{
    lanes v;
    if (p->whole)
        memcpy(&v, row + p->at[0], sizeof v);
    else
        for (int w = 0; w < LANES; w++)
            v[w] = row[p->at[w]];
    return v;
}

static inline void store(double *row, const struct place *p, lanes v)
{
    if (p->whole)
        memcpy(row + p->at[0], &v, sizeof v);
    else
        for (int w = 0; w < LANES; w++)
            if (p->at[w] >= 0)
                row[p->at[w]] = v[w];
}

/* Eight stretches of `c`, in arrays that hold each of them, one for `tiles` of them, or every `every`-th. */
struct block {
    struct place own, shared, stored, kept;
    int64_t c, shared_c, kept_c;
};

/* The block from stretch `first` on; beyond the last stretch it reads the last and writes nothing. */
static inline struct block block_of(int64_t first, int64_t c, int64_t tiles, int64_t every)
{
    int whole = first + LANES <= c;
    struct block b = {{whole, {0}}, {whole && tiles == 1, {0}}, {whole, {0}}, {whole && every == 1, {0}},
                      c, c / tiles, (c + every - 1) / every};
    for (int w = 0; w < LANES; w++) {
        int64_t at = first + w < c ? first + w : c - 1;
        b.own.at[w] = at;
        b.shared.at[w] = at / tiles;
        b.stored.at[w] = first + w < c ? at : -1;
        b.kept.at[w] = first + w < c && at % every == 0 ? at / every : -1;
    }
    return b;
}

/* A row (…,C) of an array that holds each stretch, or one for several; writing them. */
static inline lanes own(const struct block *b, const double *a, int64_t row) { return load(a + row * b->c, &b->own); }

static inline lanes shared(const struct block *b, const double *a, int64_t row)
{
    return load(a + row * b->shared_c, &b->shared);
}

static inline void put(const struct block *b, double *a, int64_t row, lanes v) { store(a + row * b->c, &b->stored, v); }

static inline void keep(const struct block *b, double *a, int64_t row, lanes v)
{
    store(a + row * b->kept_c, &b->kept, v);
}

#endif
