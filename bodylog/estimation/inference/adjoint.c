/* The smoother's backward pass in Bryson–Frazier form, eight stretches side by side. Shapes are in adjoint.py. */

#include "motion.h"

struct adjoint {
    int64_t length, stretches, joints, rows, order, offsets, tiles, width, outputs, p_rows;
    const double *dt, *encoders, *encoder_var, *y, *jac, *move, *information, *gains, *weights, *z, *p;
    const uint8_t *reset;
    const double *end;
    double *start, *smooth, *cov;
};

struct back {
    const struct adjoint *s;
    struct block at;
    int64_t k;
    lanes *known, *more;
};

/* Carry `width` columns of states (K,W), `apart` numbers from a state to the next, back over the move or dt. */
static void undo_motion(struct back *b, int64_t i, lanes *known, int64_t width, int64_t step, int64_t apart)
{
    const struct adjoint *s = b->s;
    int64_t m = s->joints, n = b->k / m;
    lanes dt = shared(&b->at, s->dt, i), old[MOST_ORDER + 1], move[MOST_ORDER + 1][MOST_ORDER + 1];
    for (int64_t j = 0; j < m; j++) {
        int leaps = s->move && any(move_of(&b->at, s->move, i, j, m, n, s->order, dt, move));
        for (int64_t l = 0; l < width; l++) {
            lanes *at = known + j * apart + l * step;
            if (!leaps) {
                carry_back(at, m * apart, (int)s->order, dt);
                continue;
            }
            for (int64_t q = 0; q < n; q++)
                old[q] = at[q * m * apart];
            for (int64_t q = 0; q < n; q++) {
                at[q * m * apart] = move[0][q] * old[0];
                for (int64_t r = 1; r < n; r++)
                    at[q * m * apart] += move[r][q] * old[r];
            }
        }
    }
}

/* The states of joints that restart at an instant depend on nothing before it: 0 in rows, and in columns if square. */
static void undo_reset(struct back *b, int64_t i, int64_t width, int square)
{
    const struct adjoint *s = b->s;
    int64_t m = s->joints;
    for (int64_t j = 0; s->reset && j < m; j++)
        for (int w = 0; w < LANES; w++) {
            if (!s->reset[(i * m + j) * b->at.shared_c + b->at.shared.at[w]])
                continue;
            for (int64_t r = 0; r < s->order; r++) {
                for (int64_t l = 0; l < width; l++)
                    b->known[(r * m + j) * width + l][w] = 0.0;
                for (int64_t a = 0; square && a < b->k; a++)
                    b->known[a * width + r * m + j][w] = 0.0;
            }
        }
}

/* Smoothed means z − P λ of the rows of p, into `found`. */
static void mean(struct back *b, int64_t i, lanes *found)
{
    const struct adjoint *s = b->s;
    int64_t k = b->k, n = s->p_rows;
    for (int64_t r = 0; r < n; r++) {
        lanes sum = own(&b->at, s->z, i * k + state_of(r, n, s->joints, k));
        for (int64_t l = 0; l < k; l++)
            sum -= own(&b->at, s->p, (i * n + r) * k + l) * b->known[l];
        put(&b->at, s->smooth, i * n + r, sum);
        found[r] = sum;
    }
}

/* Adjoints (K) back over the readings of an instant: λ − Hᵀ R⁻¹ (y − H x), where x is the smoothed mean. */
static void undo_readings(struct back *b, int64_t i, const lanes *x)
{
    const struct adjoint *s = b->s;
    int64_t m = s->joints, n = s->rows;
    for (int64_t row = 0; row < n; row++) {
        lanes information = own(&b->at, s->information, i * n + row), pull;
        if (!any(information > 0.0))
            continue;
        if (row < m) {
            pull = shared(&b->at, s->encoders, i * m + row) - x[row];
            if (s->offsets)
                pull -= x[s->p_rows - m + row];
        } else {
            pull = shared(&b->at, s->y, i * (n - m) + row - m);
            for (int64_t j = 0; j < m; j++)
                pull -= shared(&b->at, s->jac, (i * (n - m) + row - m) * m + j) * x[j];
        }
        pull = pick(information > 0.0, information * pull, all(0.0));
        if (row < m) {
            b->known[row] -= pull;
            if (s->offsets)
                b->known[b->k - m + row] -= pull;
            continue;
        }
        for (int64_t j = 0; j < m; j++)
            b->known[j] -= shared(&b->at, s->jac, (i * (n - m) + row - m) * m + j) * pull;
    }
}

/* gᵀ W and gᵀ Ψ (W), without the states `row` and `off`. */
static void weigh(struct back *b, const lanes *g, int64_t row, int64_t off, lanes *restrict sum)
{
    int64_t width = b->s->width;
    memset(sum, 0, (size_t)width * sizeof(lanes));
    for (int64_t a = 0; a < b->k; a++) {
        const lanes *known = b->known + a * width;
        lanes gain = g[a];
        for (int64_t l = 0; a != row && a != off && l < width; l++)
            sum[l] += gain * known[l];
    }
}

/* W and Ψ (K,W) back over a track's row: (I − g h)ᵀ W (I − g h) + weight hᵀ h, and (I − g h)ᵀ Ψ. */
static void undo_track(struct back *b, int64_t i, int64_t row, const lanes *g, lanes weight)
{
    const struct adjoint *s = b->s;
    int64_t m = s->joints, k = b->k, width = s->width;
    int64_t jac = (i * (s->rows - m) + row - m) * m;
    lanes curve = weight, *sum = b->more;
    weigh(b, g, -1, -1, sum);
    for (int64_t a = 0; a < k; a++)
        curve += g[a] * sum[a];
    for (int64_t j = 0; j < m; j++) {
        lanes h = shared(&b->at, s->jac, jac + j), *known = b->known + j * width;
        for (int64_t l = 0; l < width; l++)
            known[l] -= h * sum[l];
        for (int64_t a = 0; a < k; a++)
            b->known[a * width + j] -= sum[a] * h;
        for (int64_t l = 0; l < m; l++)
            known[l] += h * curve * shared(&b->at, s->jac, jac + l);
    }
}

/* W and Ψ back over an encoder, of whose reading hᵀ takes the angle `row` and, where there is one, the offset `off`.

1 − h g = R weight of an exact reading is far below the rounding of h g, and W is as much larger, so `left` is not taken
from a difference. */
static void undo_encoder(struct back *b, int64_t i, int64_t row, const lanes *g, lanes weight)
{
    const struct adjoint *s = b->s;
    int64_t width = s->width, k = b->k, off = s->offsets ? s->order * s->joints + row : row;
    lanes *angle = b->known + row * width, *offset = b->known + off * width, *sum = b->more, none = all(0.0);
    lanes exact = weight * shared(&b->at, s->encoder_var, i * s->joints + row);
    lanes of_angle = off == row ? none : g[off], of_offset = off == row ? none : g[row], left = 1.0 - g[row] - of_angle;
    left = pick(left > exact, left, exact);
    weigh(b, g, row, off, sum);
    for (int64_t l = 0; l < width; l++) {
        lanes across = offset[l] - angle[l], one = left * angle[l] - sum[l] - of_angle * across;
        offset[l] = left * offset[l] - sum[l] + of_offset * across;
        angle[l] = one;
    }
    for (lanes *at = angle;; at = offset) {
        lanes rest = none, across = at[off] - at[row], one;
        for (int64_t a = 0; a < k; a++)
            if (a != row && a != off)
                rest += g[a] * at[a];
        one = left * at[row] - rest - of_angle * across + weight;
        at[off] = left * at[off] - rest + of_offset * across + weight;
        at[row] = one;
        if (at == offset)
            break;
    }
    for (int64_t a = 0; a < k; a++)
        if (a != row && a != off) {
            b->known[a * width + row] = angle[a];
            b->known[a * width + off] = offset[a];
        }
}

/* Smoothed covariance of the outputs: P − P W P, of the angles and, with offsets, of what the encoders read. */
static void covariance(struct back *b, int64_t i)
{
    const struct adjoint *s = b->s;
    int64_t k = b->k, m = s->joints, n = s->outputs, first = s->order * m;
    lanes *rows = b->more + s->width + k, *half = rows + n * k;
    for (int64_t j = 0; j < n; j++)
        for (int64_t a = 0; a < k; a++) {
            rows[j * k + a] = own(&b->at, s->p, (i * k + j % m) * k + a);
            if (j >= m)
                rows[j * k + a] += own(&b->at, s->p, (i * k + first + j % m) * k + a);
        }
    memset(half, 0, (size_t)(n * k) * sizeof(lanes));
    for (int64_t a = 0; a < k; a++)
        for (int64_t j = 0; j < n; j++) {
            lanes p_a = rows[j * k + a];
            for (int64_t l = 0; l < k; l++)
                half[j * k + l] += p_a * b->known[a * s->width + l];
        }
    for (int64_t j = 0; j < n; j++)
        for (int64_t o = 0; o < n; o++) {
            lanes sum = rows[j * k + o % m] + (o < m ? all(0.0) : rows[j * k + first + o % m]);
            for (int64_t l = 0; l < k; l++)
                sum -= half[j * k + l] * rows[o * k + l];
            put(&b->at, s->cov, (i * n + j) * n + o, sum);
        }
}

/* W and Ψ back over the rows of an instant, one after the other. */
static void undo_rows(struct back *b, int64_t i)
{
    const struct adjoint *s = b->s;
    for (int64_t n = 0; n < s->rows; n++) {
        /* the encoders came after the tracks */
        int64_t row = n < s->joints ? s->joints - 1 - n : s->rows - 1 - (n - s->joints);
        lanes weight = own(&b->at, s->weights, i * s->rows + row), *g = b->more + s->width;
        if (!any(weight > 0.0))
            continue;
        for (int64_t a = 0; a < b->k; a++)
            g[a] = own(&b->at, s->gains, (i * s->rows + row) * b->k + a);
        if (row < s->joints)
            undo_encoder(b, i, row, g, weight);
        else
            undo_track(b, i, row, g, weight);
    }
}

/* Back over the log: adjoints (K,1), or W and Ψ (K,W). */
static void back_over(struct back *b)
{
    const struct adjoint *s = b->s;
    int64_t k = b->k, width = s->width;
    int square = width > 1;
    for (int64_t a = 0; a < k * width; a++)
        b->known[a] = own(&b->at, s->end, a);
    for (int64_t i = s->length - 1; i >= 0; i--) {
        if (s->cov)
            covariance(b, i);
        if (square) {
            undo_rows(b, i);
        } else {
            mean(b, i, b->more);
            undo_readings(b, i, b->more);
        }
        undo_reset(b, i, width, square);
        undo_motion(b, i, b->known, width, 1, width);
        if (square)
            undo_motion(b, i, b->known, k, width, 1);
        for (int64_t a = 0; square && a < k; a++)
            for (int64_t l = 0; l < a; l++)
                b->known[a * width + l] = b->known[l * width + a] =
                    0.5 * (b->known[a * width + l] + b->known[l * width + a]);
    }
    for (int64_t a = 0; a < k * width; a++)
        put(&b->at, s->start, a, b->known[a]);
}

/* 0, or 1 without memory, or 2 for a caller of another version. */
EXPORT CLONED int adjoint(const struct adjoint *s, int64_t size)
{
    if (size != sizeof *s)
        return 2;
    int64_t k = s->joints * (s->order + s->offsets), c = s->stretches;
    lanes *room = malloc((size_t)(k * s->width + s->width + k + 2 * s->outputs * k) * sizeof(lanes));
    if (!room)
        return 1;
    for (int64_t first = 0; first < c; first += LANES) {
        struct back b = {s, block_of(first, c, s->tiles, 1), k, room, room + k * s->width};
        back_over(&b);
    }
    free(room);
    return 0;
}
