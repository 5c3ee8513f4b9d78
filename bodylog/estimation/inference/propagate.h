/* The belief from an instant to the next. */
#ifndef PROPAGATE_H
#define PROPAGATE_H

#include "belief.h"
#include "motion.h"

/* Covariance (O,O) that a joint's process noise brings within dt. */
static INLINE void grow(struct belief *b, int64_t i, int64_t j, lanes dt, const int order,
                        lanes grown[MOST_ORDER][MOST_ORDER])
{
    const struct scan *s = b->s;
    lanes density = s->own_processes ? own(&b->at, s->process, j) : all(s->process[j]);
    if (s->more)
        density *= shared(&b->at, s->more, i * s->joints + j);
    process_noise(grown, density, order, dt);
}

/* By dt, with process noise and the walk of offsets. */
static INLINE void propagate(struct belief *b, int64_t i, const int order)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, width = b->width;
    lanes dt = shared(&b->at, s->dt, i), grown[MOST_ORDER][MOST_ORDER];
    fill_lower(b);
    for (int64_t j = 0; j < m; j++)
        for (int64_t l = j; l < width; l++)
            carry(b->rows + j * width + l, m * width, order, dt);
    for (int64_t a = 0; a < (order - 1) * m; a++)
        for (int64_t l = a; l < (order - 1) * m; l++) {
            lanes *at = b->rows + a * width + l;
            at[0] += dt * at[m];
            if (l + 2 * m < order * m)
                at[0] += 0.5 * dt * dt * at[2 * m];
        }
    for (int64_t j = 0; j < m; j++) {
        grow(b, i, j, dt, order, grown);
        for (int64_t r = 0; r < order; r++)
            for (int64_t q = r; q < order; q++)
                b->rows[(r * m + j) * width + q * m + j] += grown[r][q];
        if (s->offsets)
            b->rows[(order * m + j) * width + order * m + j] += all(s->drift[j]) * dt;
    }
}

/* Whether any joint moves in another way than by dt before an instant. */
static int leaps(const struct belief *b, int64_t i)
{
    const struct scan *s = b->s;
    int64_t n = b->k / s->joints;
    for (int64_t j = 0; s->move && j < s->joints; j++) {
        lanes first = shared(&b->at, s->move, i * n * n * s->joints + j);
        if (any(first == first))
            return 1;
    }
    return 0;
}

/* Replace a joint's states (S), `apart` numbers from one to the next, by their move. */
static void moved(lanes *at, int64_t apart, int64_t n, lanes move[MOST_ORDER + 1][MOST_ORDER + 1])
{
    lanes old[MOST_ORDER + 1];
    for (int64_t r = 0; r < n; r++)
        old[r] = at[r * apart];
    for (int64_t r = 0; r < n; r++) {
        at[r * apart] = move[r][0] * old[0];
        for (int64_t q = 1; q < n; q++)
            at[r * apart] += move[r][q] * old[q];
    }
}

/* By each joint's own move (S,S,M), shift (S,M) and noise (S,S,M), or by dt where these are not numbers. */
static void leap(struct belief *b, int64_t i)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, n = b->k / m, width = b->width;
    lanes dt = shared(&b->at, s->dt, i), move[MOST_ORDER + 1][MOST_ORDER + 1], grown[MOST_ORDER][MOST_ORDER];
    fill_lower(b);
    for (int64_t j = 0; j < m; j++) {
        mask own_move = move_of(&b->at, s->move, i, j, m, n, s->order, dt, move);
        grow(b, i, j, dt, (int)s->order, grown);
        for (int64_t l = 0; l < width; l++)
            moved(b->rows + j * width + l, m * width, n, move);
        for (int64_t a = 0; a < b->k; a++)
            moved(b->rows + a * width + j, m, n, move);
        for (int64_t r = 0; r < n; r++) {
            lanes *row = b->rows + (r * m + j) * width;
            row[b->k] += pick(own_move, shared(&b->at, s->shift, (i * n + r) * m + j), all(0.0));
            for (int64_t q = 0; q < n; q++) {
                lanes usual = r < s->order && q < s->order ? grown[r][q] : all(0.0);
                if (r == q && r == s->order)
                    usual = all(s->drift[j]) * dt;
                row[q * m + j] += pick(own_move, shared(&b->at, s->noise, ((i * n + r) * n + q) * m + j), usual);
            }
        }
    }
}

/* One stretch's joint restarts from a wide prior at its reading or, without one, at the angle before dt. */
static void restart(struct belief *b, int64_t j, int w, double dt, double reading)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, width = b->width, k = b->k;
    double z[MOST_ORDER] = {0.0}, offset = s->offsets ? b->rows[(s->order * m + j) * width + k][w] : 0.0;
    for (int64_t r = 0; r < s->order; r++) {
        z[r] = b->rows[(r * m + j) * width + k][w];
        for (int64_t l = 0; l < width; l++)
            b->rows[(r * m + j) * width + l][w] = 0.0;
        for (int64_t a = 0; a < k; a++)
            b->rows[a * width + r * m + j][w] = 0.0;
        b->rows[(r * m + j) * width + r * m + j][w] = s->restart[r];
    }
    double before = z[0] - dt * z[1] + 0.5 * dt * dt * z[2];
    b->rows[j * width + k][w] = isfinite(reading) ? reading - offset : before;
}

static void forget(struct belief *b, int64_t i)
{
    const struct scan *s = b->s;
    for (int64_t j = 0; j < s->joints; j++) {
        int64_t row = i * s->joints + j;
        lanes dt = shared(&b->at, s->dt, i), readings = shared(&b->at, s->encoders, row);
        for (int w = 0; w < LANES; w++)
            if (s->reset[row * b->at.shared_c + b->at.shared.at[w]])
                restart(b, j, w, dt[w], readings[w]);
    }
}

#endif
