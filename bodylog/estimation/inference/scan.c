/* The Gaussian filter: eight stretches of a log side by side, one instant of each after the other. */

#include "measure.h"
#include "propagate.h"

static void start(struct belief *b)
{
    for (int64_t a = 0; a < b->k; a++) {
        b->rows[a * b->width + b->k] = own(&b->at, b->s->start_z, a);
        for (int64_t l = 0; l < b->k; l++)
            b->rows[a * b->width + l] = own(&b->at, b->s->start_p, a * b->k + l);
    }
}

static void keep_means(const struct belief *b, int64_t n, double *z, int64_t i)
{
    for (int64_t a = 0; a < n; a++)
        keep(&b->at, z, i * n + a, b->rows[a * b->width + b->k]);
}

/* Rows (K) of the covariance: all, or those of the angles and offsets. */
static void keep_rows(const struct belief *b, double *p, int64_t i)
{
    int64_t n = b->s->p_rows, k = b->k, width = b->width;
    for (int64_t r = 0; r < n; r++) {
        int64_t a = state_of(r, n, b->s->joints, k);
        for (int64_t l = 0; l < k; l++)
            keep(&b->at, p, (i * n + r) * k + l, l < a ? b->rows[l * width + a] : b->rows[a * width + l]);
    }
}

/* Covariances (N,N) of the first m states, and from there on of the offsets. */
static void keep_cov(const struct belief *b, int64_t n, int64_t m, double *p, int64_t i)
{
    int64_t more = b->s->order * b->s->joints - m;
    for (int64_t a = 0; a < n; a++)
        for (int64_t l = a; l < n; l++) {
            lanes found = b->rows[(a < m ? a : a + more) * b->width + (l < m ? l : l + more)];
            keep(&b->at, p, (i * n + a) * n + l, found);
            if (l > a)
                keep(&b->at, p, (i * n + l) * n + a, found);
        }
}

/* The belief (K,K+1), of which the part left of the diagonal is not used. */
static void keep_belief(const struct belief *b, double *marks, int64_t block)
{
    int64_t size = b->k * b->width;
    for (int64_t a = 0; a < size; a++)
        keep(&b->at, marks, block * size + a, b->rows[a]);
}

/* Readings that are absent have no information and no weight. */
static void keep_absent(const struct belief *b, int64_t i)
{
    const struct scan *s = b->s;
    int64_t n = s->joints + s->tracks * s->rows;
    for (int64_t row = 0; row < n; row++) {
        keep(&b->at, s->information, i * n + row, all(0.0));
        if (s->gains)
            keep(&b->at, s->weights, i * n + row, all(0.0));
    }
}

static void filter(struct belief *b)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, k = b->k;
    lanes *noise = b->noise + s->tracks * s->rows;
    start(b);
    for (int64_t i = 0; i < s->length; i++) {
        b->nats = all(0.0);
        b->spread = all(1.0);
        b->counted = 0;
        if (s->marks && i % s->block == 0)
            keep_belief(b, s->marks, i / s->block);
        if (leaps(b, i))
            leap(b, i);
        else if (s->order == 3)
            propagate(b, i, 3);
        else
            propagate(b, i, 2);
        if (s->reset)
            forget(b, i);
        keep_means(b, m, s->prior, i);
        keep_cov(b, m, m, s->prior_cov, i);
        if (s->information)
            keep_absent(b, i);
        gate_encoders(b, i, noise);
        condition_tracks(b, i);
        condition_encoders(b, i, noise);
        keep_means(b, k, s->z, i);
        keep_cov(b, m * (1 + s->offsets), m, s->cov, i);
        if (s->p)
            keep_rows(b, s->p, i);
        put(&b->at, s->nats, i, b->nats + 0.5 * logarithm(b->spread));
    }
    keep_cov(b, k, k, s->end_p, 0);
}

/* 0, or 1 without memory, or 2 for a caller of another version. */
EXPORT CLONED int scan(const struct scan *s, int64_t size)
{
    if (size != sizeof *s)
        return 2;
    int64_t k = s->joints * (s->order + s->offsets), n = s->rows, width = k + 1;
    int64_t rows = k * width, projected = (n + 1) * width, noise = s->tracks * n + s->joints, work = 2 * n + n * n;
    lanes *room = malloc((size_t)(rows + projected + n * n + noise + work) * sizeof(lanes));
    if (!room)
        return 1;
    for (int64_t first = 0; first < s->stretches; first += LANES) {
        struct belief b = {.s = s, .at = block_of(first, s->stretches, s->tiles, s->every), .k = k, .width = width};
        b.rows = room;
        b.projected = b.rows + rows;
        b.cross = b.projected + projected;
        b.noise = b.cross + n * n;
        b.work = b.noise + noise;
        filter(&b);
    }
    free(room);
    return 0;
}
