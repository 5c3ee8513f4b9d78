/* The belief of eight stretches, and what is asked of it.

It is a matrix (K,K+1): the rows of the covariance, each followed by the mean. The product of a row h with it is P Hᵀ
and the predicted reading, so both are updated at once. Of the covariance only the upper triangle is used, which halves
the work and cannot become unsymmetric by rounding. Shapes of the arrays are in scan.py. */
#ifndef BELIEF_H
#define BELIEF_H

#include "lanes.h"

#define TWO_PI 6.283185307179586

/* Variances whose product stays far from overflow. */
enum { AT_ONCE = 8 };

struct scan {
    int64_t length, stretches, joints, tracks, rows, order, offsets, tiles, every, own_processes, p_rows, block;
    double gate, most, flat;
    const double *dt, *encoders, *encoder_var, *y, *jac, *var, *process, *drift, *more, *move, *shift, *noise;
    const double *restart; /* variances (O) of a joint's states before its first reading */
    const uint8_t *reset, *counted;
    const double *start_z, *start_p;
    double *prior, *prior_cov, *z, *cov, *p, *end_p, *nats, *encoder_d, *information, *gains, *weights, *marks;
};

struct belief {
    const struct scan *s;
    struct block at;
    int64_t k, width; /* K, K + 1 */
    lanes *rows, *projected, *cross, *noise, *work;
    lanes nats, spread; /* of the `counted` last readings, whose logarithm is not yet part of nats */
    int counted;
};

/* Adds a row of the belief, of which the part left of the diagonal stands in its column. */
static INLINE void add_row(const struct belief *b, int64_t a, lanes factor, lanes *restrict sum)
{
    for (int64_t l = 0; l < a; l++)
        sum[l] += factor * b->rows[l * b->width + a];
    for (int64_t l = a; l < b->width; l++)
        sum[l] += factor * b->rows[a * b->width + l];
}

static inline void fill_lower(struct belief *b)
{
    for (int64_t a = 1; a < b->k; a++)
        for (int64_t l = 0; l < a; l++)
            b->rows[a * b->width + l] = b->rows[l * b->width + a];
}

/* The nats of a reading's innovation, 0 where it has no weight. The logarithm of several variances is taken at once. */
static inline void count(struct belief *b, lanes nu, lanes weight)
{
    b->nats += 0.5 * nu * nu * weight;
    b->spread *= TWO_PI / pick(weight > 0.0, weight, all(TWO_PI));
    if (++b->counted < AT_ONCE)
        return;
    b->nats += 0.5 * logarithm(b->spread);
    b->spread = all(1.0);
    b->counted = 0;
}

/* Condition the belief on row `row` of instant i with this noise, where it is present.

projected is P Hᵀ followed by minus the innovation. */
static inline void condition(struct belief *b, const lanes *restrict projected, lanes weight, lanes noise, int64_t i,
                             int64_t row, int counted)
{
    const struct scan *s = b->s;
    int64_t k = b->k, at = i * (s->joints + s->tracks * s->rows) + row;
    if (counted)
        count(b, projected[k], weight);
    if (s->information)
        keep(&b->at, s->information, at, pick(weight > 0.0, 1.0 / noise, all(0.0)));
    if (s->gains)
        keep(&b->at, s->weights, at, weight);
    for (int64_t a = 0; a < k; a++) {
        lanes gain = projected[a] * weight, *restrict own_row = b->rows + a * b->width;
        if (s->gains)
            keep(&b->at, s->gains, at * k + a, gain);
        for (int64_t l = a; l <= k; l++)
            own_row[l] -= gain * projected[l];
    }
}

#endif
