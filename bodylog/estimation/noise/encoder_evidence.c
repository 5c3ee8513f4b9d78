/* Evidence of one joint's encoder readings alone, for many ratios of process to noise side by side. */

#include "../inference/motion.h"

struct evidence {
    int64_t length, ratios, order;
    double vague, usual;
    const double *dt, *y, *ratio;
    const uint8_t *fresh, *counts;
    double *squares, *logs, *lag;
};

/* Mean and covariance of the states in units of the noise; before: the last innovation in standard deviations. */
struct belief {
    lanes x[MOST_ORDER], p[MOST_ORDER][MOST_ORDER], before, product;
};

static void restart(const struct evidence *s, struct belief *b, double y)
{
    double size = s->vague;
    memset(b->x, 0, sizeof b->x);
    memset(b->p, 0, sizeof b->p);
    b->x[0] = all(y);
    for (int64_t r = 0; r < s->order; r++, size /= s->usual * s->usual)
        b->p[r][r] = all(size);
}

static INLINE void propagate(struct belief *b, lanes ratio, double dt, const int order)
{
    lanes grown[MOST_ORDER][MOST_ORDER] = {{{0}}};
    carry(b->x, 1, order, all(dt));
    for (int q = 0; q < order; q++)
        carry(&b->p[0][q], MOST_ORDER, order, all(dt));
    for (int r = 0; r < order; r++)
        carry(b->p[r], 1, order, all(dt));
    process_noise(grown, ratio, order, all(dt));
    for (int r = 0; r < order; r++)
        for (int q = 0; q < order; q++)
            b->p[r][q] += grown[r][q];
}

/* Condition on a reading of noise 1; the variance of the innovation, which is returned in `off`. */
static INLINE lanes condition(struct belief *b, double y, lanes *off, const int order)
{
    lanes size = b->p[0][0] + 1.0, row[MOST_ORDER];
    *off = all(y) - b->x[0];
    for (int q = 0; q < order; q++)
        row[q] = b->p[0][q];
    for (int r = 0; r < order; r++) {
        lanes gain = row[r] / size;
        b->x[r] += gain * *off;
        b->p[0][r] = b->p[r][0] = gain;
        for (int q = r; r && q < order; q++)
            b->p[r][q] = b->p[q][r] = b->p[r][q] - gain * row[q];
    }
    return size;
}

static INLINE void measure(const struct evidence *s, int64_t first, const int order)
{
    struct block at = block_of(first, s->ratios, 1, 1);
    struct belief b = {.before = all(0.0), .product = all(1.0)};
    lanes ratio = own(&at, s->ratio, 0), squares = all(0.0), logs = all(0.0), lag = all(0.0);
    for (int64_t i = 0; i < s->length; i++) {
        lanes off, size, wide;
        if (s->fresh[i])
            restart(s, &b, s->y[i]);
        else
            propagate(&b, ratio, s->dt[i], order);
        size = condition(&b, s->y[i], &off, order);
        if (s->counts[i]) {
            off /= root(size);
            b.product *= size;
        } else {
            off = all(0.0);
        }
        if (i % 16 == 15 || i + 1 == s->length) { /* one logarithm for sixteen variances */
            logs += logarithm(b.product);
            b.product = all(1.0);
        }
        squares += off * off;
        /* the least of four times this one and the one before, on the same side */
        wide = 4.0 * off;
        lanes above = pick(wide < b.before, wide, b.before), below = pick(wide > b.before, -wide, -b.before);
        lag = pick(above > lag, above, lag);
        lag = pick(below > lag, below, lag);
        b.before = off;
    }
    put(&at, s->squares, 0, squares);
    put(&at, s->logs, 0, logs);
    put(&at, s->lag, 0, lag);
}

/* 0, or 2 for a caller of another version. */
EXPORT int evidence(const struct evidence *s, int64_t size)
{
    if (size != sizeof *s)
        return 2;
    for (int64_t first = 0; first < s->ratios; first += LANES)
        if (s->order == 3)
            measure(s, first, 3);
        else
            measure(s, first, 2);
    return 0;
}
