/* The belief given the readings of an instant: gated by the prior, so that their order does not matter. */
#ifndef MEASURE_H
#define MEASURE_H

#include "belief.h"

/* (d/gate)², at least 1, of squared innovations d². */
static inline lanes beyond(const struct scan *s, lanes d2)
{
    lanes over = d2 / all(s->gate * s->gate);
    return pick(over > 1.0, over, all(1.0));
}

/* What an outlier costs beyond a Gaussian of its inflated noise. */
static inline lanes outlier_cost(const struct scan *s, lanes over, lanes inflated, lanes half_log)
{
    lanes cost = 0.5 * s->most + s->flat * (1.0 - 1.0 / over) - 0.5 * inflated - half_log;
    return pick(over > 1.0, cost, all(0.0));
}

/* P Hᵀ and the prediction (K+1) of each row h of a track, and H P Hᵀ. */
static void project(struct belief *b, int64_t track_row)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, width = b->width;
    memset(b->projected, 0, (size_t)(s->rows * width) * sizeof(lanes));
    for (int64_t d = 0; d < s->rows; d++)
        for (int64_t j = 0; j < m; j++)
            add_row(b, j, shared(&b->at, s->jac, (track_row + d) * m + j), b->projected + d * width);
    for (int64_t d = 0; d < s->rows; d++)
        for (int64_t e = 0; e < s->rows; e++) {
            lanes sum = all(0.0);
            for (int64_t j = 0; j < m; j++)
                sum += shared(&b->at, s->jac, (track_row + e) * m + j) * b->projected[d * width + j];
            b->cross[d * s->rows + e] = sum;
        }
}

/* Square of innovations (D) over the covariance with this noise (D); its determinant. */
static lanes mahalanobis(struct belief *b, const lanes *nu, const lanes *noise, lanes *size)
{
    int64_t n = b->s->rows;
    lanes *off = b->work, *cov = off + n, square = all(0.0);
    *size = all(1.0);
    memcpy(off, nu, (size_t)n * sizeof(lanes));
    memcpy(cov, b->cross, (size_t)(n * n) * sizeof(lanes));
    for (int64_t e = 0; e < n; e++) {
        cov[e * n + e] += noise[e];
        for (int64_t d = 0; d < e; d++) {
            lanes share = cov[d * n + e] / cov[d * n + d];
            off[e] -= share * off[d];
            for (int64_t f = e; f < n; f++)
                cov[e * n + f] -= share * cov[d * n + f];
        }
        square += off[e] * off[e] / cov[e * n + e];
        *size *= cov[e * n + e];
    }
    return square;
}

/* The gated noise (D) of a track, into `noise`; what its outliers cost is added. */
static void gate_track(struct belief *b, int64_t track_row, lanes *noise)
{
    const struct scan *s = b->s;
    int64_t n = s->rows;
    lanes *nu = b->work + n + n * n, size, whole;
    project(b, track_row);
    for (int64_t d = 0; d < n; d++) {
        lanes y = shared(&b->at, s->y, track_row + d);
        noise[d] = own(&b->at, s->var, track_row + d);
        nu[d] = pick(y == y, y - b->projected[d * b->width + b->k], all(0.0));
    }
    lanes d2 = mahalanobis(b, nu, noise, &size), over = beyond(s, d2);
    if (!any(over > 1.0))
        return;
    for (int64_t d = 0; d < n; d++)
        noise[d] += (b->cross[d * n + d] + noise[d]) * (over * over - 1.0);
    lanes inflated = mahalanobis(b, nu, noise, &whole);
    b->nats += outlier_cost(s, over, inflated, 0.5 * logarithm(whole / size));
}

/* Condition on a track's rows, each after the ones before it have been eliminated. */
static void condition_track(struct belief *b, int64_t i, int64_t track, const lanes *noise)
{
    const struct scan *s = b->s;
    int64_t n = s->rows, width = b->width, track_row = (i * s->tracks + track) * n;
    if (s->tracks > 1) /* the others have moved the belief */
        project(b, track_row);
    for (int64_t d = 0; d < n; d++) {
        lanes y = shared(&b->at, s->y, track_row + d), *last = b->projected + d * width + b->k;
        *last = pick(y == y, *last - y, all(0.0));
    }
    for (int64_t d = 0; d < n; d++) {
        lanes y = shared(&b->at, s->y, track_row + d), *row = b->projected + d * width;
        lanes weight = pick(y == y, 1.0 / (b->cross[d * n + d] + noise[d]), all(0.0));
        for (int64_t e = d + 1; e < n; e++) {
            lanes share = weight * b->cross[d * n + e];
            for (int64_t l = 0; l < width; l++)
                b->projected[e * width + l] -= share * row[l];
            for (int64_t f = e; f < n; f++)
                b->cross[e * n + f] -= share * b->cross[d * n + f];
        }
        condition(b, row, weight, noise[d], i, s->joints + track * n + d, 1);
    }
}

/* Whether a track is seen at an instant in any stretch. */
static int seen(const struct belief *b, int64_t track_row)
{
    for (int64_t d = 0; d < b->s->rows; d++) {
        lanes y = shared(&b->at, b->s->y, track_row + d);
        if (any(y == y))
            return 1;
    }
    return 0;
}

static void condition_tracks(struct belief *b, int64_t i)
{
    const struct scan *s = b->s;
    for (int gated = 0; gated < 2; gated++)
        for (int64_t track = 0; track < s->tracks; track++) {
            int64_t track_row = (i * s->tracks + track) * s->rows;
            lanes *noise = b->noise + track * s->rows;
            if (!seen(b, track_row))
                continue;
            if (gated)
                condition_track(b, i, track, noise);
            else
                gate_track(b, track_row, noise);
        }
}

/* Innovations of the encoders (M) in standard deviations, NaN without one; their gated noise into `noise`. */
static void gate_encoders(struct belief *b, int64_t i, lanes *noise)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, first = s->order * m;
    for (int64_t j = 0; j < m; j++) {
        const lanes *row = b->rows + j * b->width, *off = b->rows + (first + j) * b->width;
        lanes nu = shared(&b->at, s->encoders, i * m + j) - row[b->k];
        noise[j] = shared(&b->at, s->encoder_var, i * m + j);
        lanes total = row[j] + noise[j];
        if (s->offsets) {
            total += off[first + j] + 2.0 * row[first + j];
            nu -= off[b->k];
        }
        total = pick(total > noise[j], total, noise[j]); /* rounding after a reading far surer than the belief */
        lanes d = s->counted[j] ? nu / root(total) : all(NAN), over = beyond(s, d * d);
        keep(&b->at, s->encoder_d, i * m + j, d);
        if (!any(over > 1.0))
            continue;
        noise[j] += total * (over * over - 1.0);
        b->nats += outlier_cost(s, over, s->most / over, logarithm(over));
    }
}

static void condition_encoders(struct belief *b, int64_t i, const lanes *noise)
{
    const struct scan *s = b->s;
    int64_t m = s->joints, first = s->order * m;
    lanes *ph = b->projected;
    for (int64_t j = 0; j < m; j++) {
        lanes y = shared(&b->at, s->encoders, i * m + j);
        mask present = y == y;
        if (!any(present))
            continue;
        memset(ph, 0, (size_t)b->width * sizeof(lanes));
        add_row(b, j, all(1.0), ph);
        if (s->offsets)
            add_row(b, first + j, all(1.0), ph);
        lanes size = ph[j] + noise[j] + (s->offsets ? ph[first + j] : all(0.0));
        size = pick(size > noise[j], size, noise[j]); /* rounding, as in gate_encoders */
        ph[b->k] -= pick(present, y, all(0.0));
        condition(b, ph, pick(present, 1.0 / size, all(0.0)), noise[j], i, j, s->counted[j]);
    }
}

#endif
