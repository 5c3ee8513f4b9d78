/* Motion whose highest derivative is white noise, exactly discretised, as in motion.py. */
#ifndef MOTION_H
#define MOTION_H

#include "lanes.h"

enum { MOST_ORDER = 3 };

/* The state of which row r of n is: all k, or first the angles of the joints, then their offsets at the end. */
static INLINE int64_t state_of(int64_t r, int64_t n, int64_t joints, int64_t k) { return r < joints ? r : k - n + r; }

/* Derivatives of the angle, `apart` numbers from one to the next, moved by dt, in place: a Taylor series. */
static INLINE void carry(lanes *a, int64_t apart, const int order, lanes dt)
{
    a[0] += dt * a[apart];
    if (order == 3) {
        a[0] += 0.5 * dt * dt * a[2 * apart];
        a[apart] += dt * a[2 * apart];
    }
}

/* The transpose of `carry`, for adjoints. */
static INLINE void carry_back(lanes *a, int64_t apart, const int order, lanes dt)
{
    if (order == 3) {
        a[2 * apart] += dt * a[apart];
        a[2 * apart] += 0.5 * dt * dt * a[0];
    }
    a[apart] += dt * a[0];
}

/* Covariance that white noise of a density in the last derivative brings within dt: found[row][column]. */
static INLINE void process_noise(lanes found[MOST_ORDER][MOST_ORDER], lanes density, const int order, lanes dt)
{
    lanes powers[2 * MOST_ORDER];
    powers[1] = density * dt;
    for (int power = 2; power < 2 * order; power++)
        powers[power] = powers[power - 1] * dt;
    for (int i = 0; i < order; i++)
        for (int j = i; j < order; j++) {
            int power = 2 * order - 1 - i - j, scale = power;
            for (int n = 2; n < order - i; n++)
                scale *= n;
            for (int n = 2; n < order - j; n++)
                scale *= n;
            found[i][j] = found[j][i] = powers[power] * (1.0 / scale);
        }
}

/* A joint's move (S,S) before instant i: its own, from move (L,S,S,M,C), or by dt where that is not a number. */
static inline mask move_of(const struct block *b, const double *move, int64_t i, int64_t j, int64_t joints,
                           int64_t states, int64_t order, lanes dt, lanes found[MOST_ORDER + 1][MOST_ORDER + 1])
{
    mask leaps = {0};
    for (int64_t r = 0; r < states; r++)
        for (int64_t q = 0; q < states; q++) {
            lanes given = shared(b, move, ((i * states + r) * states + q) * joints + j), usual = all(r == q);
            if (q < order && q == r + 1)
                usual = dt;
            if (q < order && q == r + 2)
                usual = 0.5 * dt * dt;
            leaps = given == given;
            found[r][q] = pick(leaps, given, usual);
        }
    return leaps;
}

#endif
