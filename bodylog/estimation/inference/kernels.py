"""The loops over instants, which Numba compiles: the filter, the backward pass of the smoother,
and the evidence of one joint's encoder readings.

Shapes of the arrays are in scan.py, solution.py and encoder_noise.py; one that is absent has the
size 0. The last axis of every array is the stretch of the log, or the candidate: the innermost
loops run over it, side by side. Arrays of readings may hold one stretch for several of them: the
stretch c reads there what stands at share[c]. Arrays of results may hold every `every`-th.

The belief of a stretch is a matrix (K,K+1): the rows of the covariance, each followed by the mean.
The product of a row h with it is P Hᵀ and the predicted reading, so both are updated at once. Of
the covariance only the upper triangle is used, which halves the work and cannot become
unsymmetric by rounding. What is absent in a stretch has weight 0.

All of it stands in this file, because the cache of machine code notices changes of no other one.
"""

import math

import numpy as np

from ...types import Array
from .compiler import (
    compile_inner,
    declare_kernel,
    input_array,
    input_flags,
    number,
    output_array,
    whole,
)

TWO_PI = 2.0 * math.pi
LEAST_PRODUCT = 1e-100
MOST_PRODUCT = 1e100
"""A product of variances beyond these is replaced by its logarithm, far from overflow."""
READINGS_AT_ONCE = 16
"""Variances, in units of the noise, of which one logarithm is taken."""
NOISE_SHARES = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
"""1/((2p−1−i−j) (p−1−i)! (p−1−j)!) of order p = 3; those of order 2 are its lower right part."""


# Motion whose highest derivative is white noise, exactly discretised, as in motion.py.


@compile_inner
def integrate_noise(dt: Array, order: int, growth: Array) -> None:
    """Write into growth (O,O,C) the covariance that white noise of density 1 adds in dt (C,)."""
    for r in range(order):
        for q in range(order):
            for c in range(len(dt)):
                growth[r, q, c] = dt[c] * NOISE_SHARES[3 - order + r, 3 - order + q]
            for _ in range(2 * order - 2 - r - q):
                for c in range(len(dt)):
                    growth[r, q, c] *= dt[c]


@compile_inner
def move_by_dt(belief: Array, joints: int, order: int, dt: Array) -> None:
    """Make P and z of the belief F P Fᵀ and F z, where F is Taylor's series of each joint within
    dt (C,).

    First the rows, in the order in which each reads others that are still those of before.
    """
    moving = (order - 1) * joints
    for a in range(moving):
        for b in range(a, belief.shape[1]):
            rate = belief[min(a + joints, b), max(a + joints, b)]
            if a + 2 * joints < order * joints:
                acceleration = belief[min(a + 2 * joints, b), max(a + 2 * joints, b)]
                for c in range(len(dt)):
                    moved = belief[a, b, c] + dt[c] * rate[c]
                    belief[a, b, c] = moved + 0.5 * dt[c] * dt[c] * acceleration[c]
            else:
                for c in range(len(dt)):
                    belief[a, b, c] += dt[c] * rate[c]
    for a in range(moving):
        for b in range(a, moving):
            if b + 2 * joints < order * joints:
                for c in range(len(dt)):
                    moved = belief[a, b, c] + dt[c] * belief[a, b + joints, c]
                    moved += 0.5 * dt[c] * dt[c] * belief[a, b + 2 * joints, c]
                    belief[a, b, c] = moved
            else:
                for c in range(len(dt)):
                    belief[a, b, c] += dt[c] * belief[a, b + joints, c]


@compile_inner
def propagate_belief(belief: Array, dt: Array, density: Array, drift: Array, growth: Array) -> None:
    """Move the belief by dt (C,), with process noise (M,C) and the walk (M,) of offsets."""
    joints = len(density)
    order = len(growth)
    move_by_dt(belief, joints, order, dt)
    for j in range(joints):
        for r in range(order):
            for q in range(r, order):
                for c in range(len(dt)):
                    belief[r * joints + j, q * joints + j, c] += density[j, c] * growth[r, q, c]
    for j in range(len(drift)):
        offset = order * joints + j
        for c in range(len(dt)):
            belief[offset, offset, c] += drift[j] * dt[c]


@compile_inner
def mirror_upper_triangle(belief: Array) -> None:
    """Fill the lower triangle of the covariance."""
    for a in range(1, len(belief)):
        for b in range(a):
            for c in range(belief.shape[2]):
                belief[a, b, c] = belief[b, a, c]


@compile_inner
def has_own_motion(move: Array, i: int) -> bool:
    """Whether a joint of any stretch has a motion of its own before instant i."""
    if move.size > 0:
        for j in range(move.shape[3]):
            for s in range(move.shape[4]):
                if not math.isnan(move[i, 0, 0, j, s]):
                    return True
    return False


@compile_inner
def choose_motion(
    move: Array, i: int, j: int, s: int, dt: float, order: int, motion: Array
) -> bool:
    """Write a joint's motion before instant i into motion (S,S); whether it is its own, and not by
    Taylor's series.
    """
    own = not math.isnan(move[i, 0, 0, j, s])
    for r in range(len(motion)):
        for q in range(len(motion)):
            if own:
                motion[r, q] = move[i, r, q, j, s]
            elif q == r:
                motion[r, q] = 1.0
            elif q == r + 1 and q < order:
                motion[r, q] = dt
            elif q == r + 2 and q < order:
                motion[r, q] = 0.5 * dt * dt
            else:
                motion[r, q] = 0.0
    return own


@compile_inner
def move_joint(belief: Array, j: int, joints: int, c: int, motion: Array, old: Array) -> None:
    """Multiply rows and columns of a joint's states by motion (S,S); old (S,): room."""
    states, width, _ = belief.shape
    for b in range(width):
        for r in range(len(old)):
            old[r] = belief[r * joints + j, b, c]
        for r in range(len(old)):
            moved = motion[r, 0] * old[0]
            for q in range(1, len(old)):
                moved += motion[r, q] * old[q]
            belief[r * joints + j, b, c] = moved
    for a in range(states):
        for r in range(len(old)):
            old[r] = belief[a, r * joints + j, c]
        for r in range(len(old)):
            moved = motion[r, 0] * old[0]
            for q in range(1, len(old)):
                moved += motion[r, q] * old[q]
            belief[a, r * joints + j, c] = moved


@compile_inner
def move_by_own_motion(
    belief: Array,
    i: int,
    share: Array,
    dt: Array,
    density: Array,
    drift: Array,
    growth: Array,
    move: Array,
    shift: Array,
    noise: Array,
    motion: Array,
    old: Array,
) -> None:
    """Move the belief by each joint's own motion, shift and noise, or by dt without these.

    motion (S,S), old (S,): room.
    """
    states = len(belief)
    joints, stretches = density.shape
    size = states // joints
    order = len(growth)
    mirror_upper_triangle(belief)
    for j in range(joints):
        for c in range(stretches):
            own = choose_motion(move, i, j, share[c], dt[c], order, motion)
            move_joint(belief, j, joints, c, motion, old)
            for r in range(size):
                at = r * joints + j
                if own:
                    belief[at, states, c] += shift[i, r, j, share[c]]
                for q in range(size):
                    if own:
                        belief[at, q * joints + j, c] += noise[i, r, q, j, share[c]]
                    elif r < order and q < order:
                        belief[at, q * joints + j, c] += density[j, c] * growth[r, q, c]
                    elif r == q:
                        belief[at, at, c] += drift[j] * dt[c]


@compile_inner
def restart_joint(
    belief: Array, j: int, joints: int, c: int, variances: Array, dt: float, reading: float
) -> None:
    """Give a joint's states the prior variances (O,), but for its offset.

    Its angle is that of the reading or, without one, that before dt.
    """
    states = len(belief)
    order = len(variances)
    angle = belief[j, states, c] - dt * belief[joints + j, states, c]
    if order == 3:
        angle += 0.5 * dt * dt * belief[2 * joints + j, states, c]
    if math.isfinite(reading):
        angle = reading
        if states > order * joints:
            angle -= belief[order * joints + j, states, c]
    for r in range(order):
        at = r * joints + j
        for a in range(states):
            belief[at, a, c] = 0.0
            belief[a, at, c] = 0.0
        belief[at, states, c] = 0.0
        belief[at, at, c] = variances[r]
    belief[j, states, c] = angle


# The belief given the readings of an instant, gated by the prior, so that their order does not
# matter.


@compile_inner
def add_innovation_nats(innovation: Array, weight: Array, nats: Array, product: Array) -> None:
    """Add the nats (C,) of a reading's innovation (C,), of the inverse variance `weight` (C,).

    product (C,): of inverse variances whose logarithm is not yet in nats.
    """
    for c in range(len(weight)):
        if weight[c] != 0.0:
            nats[c] += 0.5 * innovation[c] * innovation[c] * weight[c]
            product[c] *= TWO_PI / weight[c]
            if not LEAST_PRODUCT < product[c] < MOST_PRODUCT:
                nats[c] += 0.5 * math.log(product[c])
                product[c] = 1.0


@compile_inner
def condition_belief(belief: Array, projected: Array, weight: Array) -> None:
    """Condition on a reading with the inverse variance `weight` (C,).

    projected (K+1,C): P Hᵀ, followed by minus the innovation.
    """
    for a in range(len(belief)):
        for b in range(a, len(projected)):
            for c in range(len(weight)):
                belief[a, b, c] -= projected[a, c] * weight[c] * projected[b, c]


@compile_inner
def keep_reading(
    projected: Array,
    weight: Array,
    noise: Array,
    i: int,
    reading: int,
    every: int,
    information: Array,
    gains: Array,
    weights: Array,
) -> None:
    """Keep what a smoother needs of a reading: information, and weight and gain."""
    for c in range(0, len(weight) if information.size > 0 else 0, every):
        information[i, reading, c // every] = 1.0 / noise[c] if weight[c] > 0.0 else 0.0
    for c in range(0, len(weight) if weights.size > 0 else 0, every):
        weights[i, reading, c // every] = weight[c]
        for a in range(len(projected) - 1):
            gains[i, reading, a, c // every] = projected[a, c] * weight[c]


@compile_inner
def project_track(
    belief: Array,
    jac: Array,
    i: int,
    track: int,
    share: Array,
    seen: Array,
    projected: Array,
    cross: Array,
    slope: Array,
) -> None:
    """Project the belief on a track's rows h, seen (D,C) or NaN.

    Writes P Hᵀ and minus the innovation into projected (D,K+1,C), and H P Hᵀ into cross (D,D,C).
    slope (C,): room.
    """
    rows, joints = jac.shape[2:4]
    for d in range(rows):
        for j in range(joints):
            for c in range(len(share)):
                slope[c] = jac[i, track, d, j, share[c]]
            for b in range(projected.shape[1]):
                row = belief[min(j, b), max(j, b)]
                for c in range(len(share)):
                    before = projected[d, b, c] if j > 0 else 0.0
                    projected[d, b, c] = before + slope[c] * row[c]
        for c in range(len(share)):
            innovation = seen[d, c] - projected[d, -1, c]
            projected[d, -1, c] = 0.0 if math.isnan(innovation) else -innovation
    for e in range(rows):
        for j in range(joints):
            for c in range(len(share)):
                slope[c] = jac[i, track, e, j, share[c]]
            for d in range(rows):
                for c in range(len(share)):
                    before = cross[d, e, c] if j > 0 else 0.0
                    cross[d, e, c] = before + slope[c] * projected[d, j, c]


@compile_inner
def square_innovation(
    projected: Array, cross: Array, noise: Array, c: int, off: Array, system: Array
) -> tuple[float, float]:
    """A stretch's squared innovation over its covariance H P Hᵀ + R, and the determinant.

    projected (D,K+1,C), cross (D,D,C): of project_track · noise (D,C): R · off (D,), system
    (D,D): room.
    """
    square = 0.0
    size = 1.0
    for e in range(len(off)):
        off[e] = projected[e, -1, c]
        for d in range(len(off)):
            system[e, d] = cross[e, d, c]
        system[e, e] += noise[e, c]
        for d in range(e):
            factor = system[d, e] / system[d, d]
            off[e] -= factor * off[d]
            for f in range(e, len(off)):
                system[e, f] -= factor * system[d, f]
        square += off[e] * off[e] / system[e, e]
        size *= system[e, e]
    return square, size


@compile_inner
def gate_track(
    projected: Array,
    cross: Array,
    limits: tuple[float, float, float],
    noise: Array,
    nats: Array,
    off: Array,
    system: Array,
) -> None:
    """Inflate the noise (D,C) of a track's rows that are outliers; add what these cost (C,).

    limits: gate in standard deviations; cost of an outlier there and, far off, beside it (nats).
    """
    gate, cost, flat = limits
    for c in range(len(nats)):
        square, size = square_innovation(projected, cross, noise, c, off, system)
        over = square / (gate * gate)
        if over > 1.0:
            for d in range(len(noise)):
                noise[d, c] += (cross[d, d, c] + noise[d, c]) * (over * over - 1.0)
            inflated, wide_size = square_innovation(projected, cross, noise, c, off, system)
            half_log = 0.5 * math.log(wide_size / size)
            nats[c] += cost + flat * (1.0 - 1.0 / over) - 0.5 * inflated - half_log


@compile_inner
def eliminate_row(projected: Array, cross: Array, d: int, weight: Array) -> None:
    """Make the later rows of a track independent of its row d, of inverse variance weight (C,)."""
    rows, width, stretches = projected.shape
    for e in range(d + 1, rows):
        for b in range(width):
            for c in range(stretches):
                projected[e, b, c] -= weight[c] * cross[d, e, c] * projected[d, b, c]
        for f in range(rows - 1, e - 1, -1):
            for c in range(stretches):
                cross[e, f, c] -= weight[c] * cross[d, e, c] * cross[d, f, c]


@compile_inner
def gate_encoder(
    belief: Array,
    reading: Array,
    j: int,
    offset: int,
    limits: tuple[float, float, float],
    noise: Array,
    nats: Array,
    deviation: Array,
) -> None:
    """Inflate the noise (C,) of readings (C,) that are outliers; add what these cost (C,).

    offset: state of the encoder's offset, or −1 · deviation (C,): innovations in standard
    deviations, which it finds.
    """
    gate, cost, flat = limits
    for c in range(len(noise)):
        innovation = reading[c] - belief[j, -1, c]
        total = belief[j, j, c] + noise[c]
        if offset >= 0:
            total += belief[offset, offset, c] + 2.0 * belief[j, offset, c]
            innovation -= belief[offset, -1, c]
        total = max(noise[c], total)  # rounding after a reading far surer than the belief
        deviation[c] = innovation / math.sqrt(total)
        over = deviation[c] * deviation[c] / (gate * gate)
        if over > 1.0:
            noise[c] += total * (over * over - 1.0)
            nats[c] += cost + flat * (1.0 - 1.0 / over) - cost / over - math.log(over)


@compile_inner
def is_read(reading: Array) -> bool:
    """Whether an encoder is read in any stretch (C,)."""
    anything = False
    for c in range(len(reading)):
        anything |= not math.isnan(reading[c])
    return anything


@compile_inner
def project_encoder(
    belief: Array,
    reading: Array,
    j: int,
    offset: int,
    noise: Array,
    projected: Array,
    weight: Array,
) -> None:
    """Project the belief on an encoder's readings (C,).

    Writes P Hᵀ and minus the innovation into projected (K+1,C), and inverse variances into
    weight (C,). offset: state of the encoder's offset, or −1.
    """
    for b in range(len(projected)):
        row = belief[min(j, b), max(j, b)]
        for c in range(len(weight)):
            projected[b, c] = row[c]
        if offset >= 0:
            more = belief[min(offset, b), max(offset, b)]
            for c in range(len(weight)):
                projected[b, c] += more[c]
    for c in range(len(weight)):
        size = projected[j, c] + noise[c]
        if offset >= 0:
            size += projected[offset, c]
        absent = math.isnan(reading[c])
        projected[-1, c] -= 0.0 if absent else reading[c]
        size = max(noise[c], size)  # rounding, as in gate_encoder
        weight[c] = 0.0 if absent else 1.0 / size


@compile_inner
def take_track(
    y: Array, var: Array, i: int, track: int, share: Array, seen: Array, noise: Array
) -> bool:
    """Copy a track's rows into seen (D,C), NaN where not, and noise (D,C); whether any is seen."""
    anything = False
    for d in range(len(seen)):
        for c in range(len(share)):
            seen[d, c] = y[i, track, d, share[c]]
            noise[d, c] = var[i, track, d, c]
            anything |= not math.isnan(seen[d, c])
    return anything


# What is kept of the belief.


@compile_inner
def keep_means(belief: Array, i: int, every: int, means: Array) -> None:
    """Copy the means of the first states into means (L,…,C)."""
    for a in range(means.shape[1]):
        for kept in range(means.shape[2]):
            means[i, a, kept] = belief[a, -1, kept * every]


@compile_inner
def keep_covariances(
    belief: Array, i: int, every: int, joints: int, later: int, cov: Array
) -> None:
    """Copy covariances of angles and, behind these, of states from `later` on into (L,O,O,C)."""
    for a in range(cov.shape[1]):
        at = a if a < joints else a - joints + later
        for b in range(a, cov.shape[1]):
            beside = b if b < joints else b - joints + later
            for kept in range(cov.shape[3]):
                cov[i, a, b, kept] = belief[at, beside, kept * every]
                cov[i, b, a, kept] = belief[at, beside, kept * every]


@compile_inner
def keep_rows(belief: Array, i: int, every: int, joints: int, p: Array) -> None:
    """Copy rows of the covariance into p (L,O,K,C): all, or those of the angles and offsets."""
    _, rows, states, stretches = p.shape
    for r in range(rows):
        a = r if r < joints else states - rows + r
        for b in range(states):
            for kept in range(stretches):
                p[i, r, b, kept] = belief[min(a, b), max(a, b), kept * every]


@compile_inner
def keep_belief(belief: Array, at: int, every: int, marks: Array) -> None:
    """Copy all of the belief into marks (B,K,K+1,C), where what is below the diagonal has no
    meaning.
    """
    for a in range(len(belief)):
        for b in range(belief.shape[1]):
            for kept in range(marks.shape[3]):
                marks[at, a, b, kept] = belief[a, b, kept * every]


@compile_inner
def clear_readings(i: int, information: Array, weights: Array) -> None:
    """Write no information and no weight, until a reading comes."""
    for reading in range(information.shape[1]):
        for kept in range(information.shape[2]):
            information[i, reading, kept] = 0.0
    for reading in range(weights.shape[1]):
        for kept in range(weights.shape[2]):
            weights[i, reading, kept] = 0.0


@declare_kernel(
    # dt, encoders, encoder_var, y, jac, var, reset, process_factor, move, shift, noise
    *(input_array(axes) for axes in (2, 3, 3, 4, 5, 4)),
    input_flags(3),
    *(input_array(axes) for axes in (3, 5, 4, 5)),
    # process, drift, counted, restart
    input_array(2),
    input_array(1),
    input_flags(1),
    input_array(1),
    # gate, outlier_cost, flat, every, block, start_z, start_p
    number,
    number,
    number,
    whole,
    whole,
    input_array(2),
    input_array(3),
    # prior, prior_cov, z, cov, end_p, nats, encoder_d, p, information, gains, weights, marks
    *(output_array(axes) for axes in (3, 4, 3, 4, 3, 2, 3, 4, 3, 4, 3, 4)),
)
def filter_instants(
    dt: Array,
    encoders: Array,
    encoder_var: Array,
    y: Array,
    jac: Array,
    var: Array,
    reset: Array,
    process_factor: Array,
    move: Array,
    shift: Array,
    noise: Array,
    process: Array,
    drift: Array,
    counted: Array,
    restart: Array,
    gate: float,
    outlier_cost: float,
    flat: float,
    every: int,
    block: int,
    start_z: Array,
    start_p: Array,
    prior: Array,
    prior_cov: Array,
    z: Array,
    cov: Array,
    end_p: Array,
    nats: Array,
    encoder_d: Array,
    p: Array,
    information: Array,
    gains: Array,
    weights: Array,
    marks: Array,
) -> None:
    """Filter every stretch: an instant of all of them, then the next."""
    joints, shared = encoders.shape[1:]
    tracks, rows = y.shape[1:3]
    states, stretches = start_z.shape
    order = len(restart)
    limits = gate, outlier_cost, flat
    share = np.empty(stretches, np.int64)
    step = np.empty(stretches)
    density = np.empty((joints, stretches))
    growth = np.empty((order, order, stretches))
    reading = np.empty((joints, stretches))
    encoder_noise = np.empty((joints, stretches))
    seen = np.empty((tracks, rows, stretches))
    track_noise = np.empty((tracks, rows, stretches))
    sees = np.empty(tracks, np.bool_)
    projected = np.empty((rows, states + 1, stretches))
    cross = np.empty((rows, rows, stretches))
    slope = np.empty(stretches)
    off = np.empty(rows)
    system = np.empty((rows, rows))
    motion = np.empty((states // joints, states // joints))
    old = np.empty(states // joints)
    read_by_encoder = np.empty((states + 1, stretches))
    weight = np.empty(stretches)
    deviation = np.empty((joints, stretches))
    sum_nats = np.empty(stretches)
    product = np.empty(stretches)
    belief = np.empty((states, states + 1, stretches))
    for c in range(stretches):
        share[c] = c // (stretches // shared)
        for a in range(states):
            belief[a, states, c] = start_z[a, c]
            for b in range(states):
                belief[a, b, c] = start_p[a, b, c]
    for i in range(len(dt)):
        for c in range(stretches):
            step[c] = dt[i, share[c]]
            sum_nats[c] = 0.0
            product[c] = 1.0
            for j in range(joints):
                density[j, c] = process[j, c % process.shape[1]]
                if process_factor.size > 0:
                    density[j, c] *= process_factor[i, j, share[c]]
                reading[j, c] = encoders[i, j, share[c]]
                encoder_noise[j, c] = encoder_var[i, j, share[c]]
                deviation[j, c] = math.nan
        if marks.size > 0 and i % block == 0:
            keep_belief(belief, i // block, every, marks)
        integrate_noise(step, order, growth)
        if has_own_motion(move, i):
            move_by_own_motion(
                belief, i, share, step, density, drift, growth, move, shift, noise, motion, old
            )
        else:
            propagate_belief(belief, step, density, drift, growth)
        if reset.size > 0:
            for j in range(joints):
                for c in range(stretches):
                    if reset[i, j, share[c]]:
                        restart_joint(belief, j, joints, c, restart, step[c], reading[j, c])
        keep_means(belief, i, every, prior)
        keep_covariances(belief, i, every, joints, joints, prior_cov)
        clear_readings(i, information, weights)
        for j in range(joints):
            if counted[j] and is_read(reading[j]):
                offset = order * joints + j if len(drift) > 0 else -1
                gate_encoder(
                    belief, reading[j], j, offset, limits, encoder_noise[j], sum_nats, deviation[j]
                )
            for kept in range(encoder_d.shape[2]):
                encoder_d[i, j, kept] = deviation[j, kept * every]
        for track in range(tracks):
            sees[track] = take_track(y, var, i, track, share, seen[track], track_noise[track])
            if sees[track]:
                project_track(belief, jac, i, track, share, seen[track], projected, cross, slope)
                gate_track(projected, cross, limits, track_noise[track], sum_nats, off, system)
        for track in range(tracks):
            if not sees[track]:
                continue
            if tracks > 1:  # the others have moved the belief
                project_track(belief, jac, i, track, share, seen[track], projected, cross, slope)
            for d in range(rows):
                own_noise = track_noise[track, d]
                for c in range(stretches):
                    absent = math.isnan(seen[track, d, c])
                    weight[c] = 0.0 if absent else 1.0 / (cross[d, d, c] + own_noise[c])
                eliminate_row(projected, cross, d, weight)
                add_innovation_nats(projected[d, states], weight, sum_nats, product)
                condition_belief(belief, projected[d], weight)
                keep_reading(
                    projected[d],
                    weight,
                    own_noise,
                    i,
                    joints + track * rows + d,
                    every,
                    information,
                    gains,
                    weights,
                )
        for j in range(joints):
            if not is_read(reading[j]):
                continue
            offset = order * joints + j if len(drift) > 0 else -1
            project_encoder(
                belief, reading[j], j, offset, encoder_noise[j], read_by_encoder, weight
            )
            if counted[j]:
                add_innovation_nats(read_by_encoder[states], weight, sum_nats, product)
            condition_belief(belief, read_by_encoder, weight)
            keep_reading(
                read_by_encoder, weight, encoder_noise[j], i, j, every, information, gains, weights
            )
        for c in range(stretches):
            nats[i, c] = sum_nats[c] + 0.5 * math.log(product[c])
        keep_means(belief, i, every, z)
        keep_covariances(belief, i, every, joints, order * joints, cov)
        if p.size > 0:
            keep_rows(belief, i, every, joints, p)
    mirror_upper_triangle(belief)
    for a in range(states):
        for b in range(states):
            for kept in range(end_p.shape[2]):
                end_p[a, b, kept] = belief[a, b, kept * every]


# Back over the log: adjoints λ (K,1,C) of the means or, in Bryson–Frazier form, the information W
# beside the map Ψ (K,2K,C) or alone (K,K,C).


@compile_inner
def undo_motion(known: Array, square: bool, joints: int, order: int, dt: Array) -> None:
    """Make λ Fᵀ λ, or W and Ψ Fᵀ W F and Fᵀ Ψ, where F is Taylor's series of each joint within dt
    (C,).
    """
    states, width, stretches = known.shape
    for j in range(joints):
        for b in range(width):
            for c in range(stretches):
                rate = known[joints + j, b, c]
                if order == 3:
                    known[2 * joints + j, b, c] += dt[c] * rate
                    known[2 * joints + j, b, c] += 0.5 * dt[c] * dt[c] * known[j, b, c]
                known[joints + j, b, c] = rate + dt[c] * known[j, b, c]
    for j in range(joints if square else 0):
        for a in range(states):
            for c in range(stretches):
                rate = known[a, joints + j, c]
                if order == 3:
                    known[a, 2 * joints + j, c] += dt[c] * rate
                    known[a, 2 * joints + j, c] += 0.5 * dt[c] * dt[c] * known[a, j, c]
                known[a, joints + j, c] = rate + dt[c] * known[a, j, c]


@compile_inner
def undo_joint_motion(
    known: Array, square: bool, j: int, joints: int, c: int, motion: Array, old: Array
) -> None:
    """Carry λ, or W and Ψ, back over one joint's motion (S,S) in a stretch; old (S,): room."""
    states, width, _ = known.shape
    for b in range(width):
        for r in range(len(old)):
            old[r] = known[r * joints + j, b, c]
        for q in range(len(old)):
            moved = motion[0, q] * old[0]
            for r in range(1, len(old)):
                moved += motion[r, q] * old[r]
            known[q * joints + j, b, c] = moved
    for a in range(states if square else 0):
        for r in range(len(old)):
            old[r] = known[a, r * joints + j, c]
        for q in range(len(old)):
            moved = motion[0, q] * old[0]
            for r in range(1, len(old)):
                moved += motion[r, q] * old[r]
            known[a, q * joints + j, c] = moved


@compile_inner
def undo_restart(known: Array, square: bool, j: int, joints: int, order: int, c: int) -> None:
    """Clear λ, or W and Ψ, of a joint that restarts: its states depend on nothing before."""
    states, width, _ = known.shape
    for r in range(order):
        for b in range(width):
            known[r * joints + j, b, c] = 0.0
        for a in range(states if square else 0):
            known[a, r * joints + j, c] = 0.0


@compile_inner
def smooth_means(known: Array, i: int, joints: int, z: Array, p: Array, smooth: Array) -> None:
    """Write smoothed means z − P λ of the rows that p (L,O,K,C) holds into smooth (L,O,C)."""
    _, rows, states, stretches = p.shape
    for r in range(rows):
        a = r if r < joints else states - rows + r
        for c in range(stretches):
            smooth[i, r, c] = z[i, a, c]
        for b in range(states):
            for c in range(stretches):
                smooth[i, r, c] -= p[i, r, b, c] * known[b, 0, c]


@compile_inner
def undo_encoder_readings(
    known: Array,
    i: int,
    share: Array,
    encoders: Array,
    information: Array,
    smooth: Array,
    offsets: bool,
) -> None:
    """Make λ of the encoders' readings λ − Hᵀ R⁻¹ (y − H x), where x is the smoothed mean."""
    joints = encoders.shape[1]
    first = len(known) - joints
    for j in range(joints):
        for c in range(len(share)):
            if information[i, j, c] > 0.0:
                pull = encoders[i, j, share[c]] - smooth[i, j, c]
                if offsets:
                    pull -= smooth[i, smooth.shape[1] - joints + j, c]
                pull *= information[i, j, c]
                known[j, 0, c] -= pull
                if offsets:
                    known[first + j, 0, c] -= pull


@compile_inner
def undo_track_readings(
    known: Array, i: int, share: Array, y: Array, jac: Array, information: Array, smooth: Array
) -> None:
    """Make λ of the tracks' rows λ − Hᵀ R⁻¹ (y − H x), where x is the smoothed mean."""
    _, tracks, rows, joints, _ = jac.shape
    for track in range(tracks):
        for d in range(rows):
            reading = joints + track * rows + d
            for c in range(len(share)):
                if information[i, reading, c] > 0.0:
                    pull = y[i, track, d, share[c]]
                    for j in range(joints):
                        pull -= jac[i, track, d, j, share[c]] * smooth[i, j, c]
                    pull *= information[i, reading, c]
                    for j in range(joints):
                        known[j, 0, c] -= jac[i, track, d, j, share[c]] * pull


@compile_inner
def weigh_rows(known: Array, gain: Array, row: int, off: int, total: Array) -> None:
    """Write gᵀ W and gᵀ Ψ, without the states `row` and `off`, into total (W,C)."""
    states, width, stretches = known.shape
    for b in range(width):
        for c in range(stretches):
            total[b, c] = 0.0
    for a in range(states):
        if a not in (row, off):
            for b in range(width):
                for c in range(stretches):
                    total[b, c] += gain[a, c] * known[a, b, c]


@compile_inner
def undo_track_row(
    known: Array, gain: Array, weight: Array, slope: Array, total: Array, curve: Array
) -> None:
    """Make W and Ψ (I − g h)ᵀ W (I − g h) + weight hᵀ h and (I − g h)ᵀ Ψ, of a track's row h.

    slope (M,C): h; total (W,C), curve (C,): room.
    """
    states, width, stretches = known.shape
    weigh_rows(known, gain, -1, -1, total)
    for c in range(stretches):
        curve[c] = weight[c]
    for a in range(states):
        for c in range(stretches):
            curve[c] += gain[a, c] * total[a, c]
    for j in range(len(slope)):
        for b in range(width):
            for c in range(stretches):
                known[j, b, c] -= slope[j, c] * total[b, c]
        for a in range(states):
            for c in range(stretches):
                known[a, j, c] -= total[a, c] * slope[j, c]
        for b in range(len(slope)):
            for c in range(stretches):
                known[j, b, c] += slope[j, c] * curve[c] * slope[b, c]


@compile_inner
def undo_encoder_columns(
    known: Array, gain: Array, weight: Array, row: int, off: int, at: int, left: Array
) -> None:
    """Carry back the columns of an encoder's states in the row `at` of W; see undo_encoder_row."""
    both = 1.0 if off != row else 0.0
    for c in range(len(left)):
        rest = 0.0
        for a in range(len(known)):
            if a not in (row, off):
                rest += gain[a, c] * known[at, a, c]
        across = both * (known[at, off, c] - known[at, row, c])
        angle = left[c] * known[at, row, c] - rest - gain[off, c] * across + weight[c]
        known[at, off, c] = left[c] * known[at, off, c] - rest + gain[row, c] * across + weight[c]
        known[at, row, c] = angle


@compile_inner
def undo_encoder_row(
    known: Array,
    gain: Array,
    weight: Array,
    row: int,
    off: int,
    noise: Array,
    total: Array,
    left: Array,
) -> None:
    """Carry W and Ψ back over an encoder, which reads the angle `row` and the offset `off`, as
    undo_track_row does; off = row: no offset.

    1 − h g = R weight of an exact reading is far below the rounding of h g, and W is as much
    larger, so `left` (C,) is not taken from a difference. total (W,C): room.
    """
    states, width, stretches = known.shape
    both = 1.0 if off != row else 0.0
    for c in range(stretches):
        left[c] = max(weight[c] * noise[c], 1.0 - gain[row, c] - both * gain[off, c])
    weigh_rows(known, gain, row, off, total)
    for b in range(width):
        for c in range(stretches):
            across = both * (known[off, b, c] - known[row, b, c])
            angle = left[c] * known[row, b, c] - total[b, c] - gain[off, c] * across
            known[off, b, c] = left[c] * known[off, b, c] - total[b, c] + gain[row, c] * across
            known[row, b, c] = angle
    undo_encoder_columns(known, gain, weight, row, off, row, left)
    if off != row:
        undo_encoder_columns(known, gain, weight, row, off, off, left)
    for a in range(states):
        if a not in (row, off):
            for c in range(stretches):
                known[a, row, c] = known[row, a, c]
                known[a, off, c] = known[off, a, c]


@compile_inner
def smooth_covariances(
    known: Array, i: int, joints: int, offset: int, p: Array, cov: Array, rows: Array, half: Array
) -> None:
    """Write P − P W P of the angles and, behind these, of what encoders with offsets read, into
    cov (L,O,O,C).

    offset: state of the first offset · rows (O,K,C), half (O,K,C): room.
    """
    outputs, states, stretches = rows.shape
    for r in range(outputs):
        for a in range(states):
            for c in range(stretches):
                rows[r, a, c] = p[i, r % joints, a, c]
                if r >= joints:
                    rows[r, a, c] += p[i, offset + r % joints, a, c]
                half[r, a, c] = 0.0
    for r in range(outputs):
        for a in range(states):
            for b in range(states):
                for c in range(stretches):
                    half[r, b, c] += rows[r, a, c] * known[a, b, c]
    for r in range(outputs):
        for q in range(outputs):
            for c in range(stretches):
                cov[i, r, q, c] = rows[r, q % joints, c]
                if q >= joints:
                    cov[i, r, q, c] += rows[r, offset + q % joints, c]
            for a in range(states):
                for c in range(stretches):
                    cov[i, r, q, c] -= half[r, a, c] * rows[q, a, c]


@compile_inner
def make_symmetric(known: Array) -> None:
    """Make W the mean of itself and its transpose."""
    for a in range(len(known)):
        for b in range(a):
            for c in range(known.shape[2]):
                mean = 0.5 * (known[a, b, c] + known[b, a, c])
                known[a, b, c] = mean
                known[b, a, c] = mean


@compile_inner
def take_reading(
    gains: Array, weights: Array, i: int, reading: int, gain: Array, weight: Array
) -> bool:
    """Copy a reading's gain (K,C) and weight (C,); whether it has any."""
    anything = False
    for c in range(len(weight)):
        weight[c] = weights[i, reading, c]
        anything |= weight[c] > 0.0
    for a in range(len(gain) if anything else 0):
        for c in range(len(weight)):
            gain[a, c] = gains[i, reading, a, c]
    return anything


@declare_kernel(
    # dt, encoders, encoder_var, y, jac, reset, move
    *(input_array(axes) for axes in (2, 3, 3, 4, 5)),
    input_flags(3),
    input_array(5),
    # order, length, information, gains, weights, z, p, end
    whole,
    whole,
    *(input_array(axes) for axes in (3, 4, 3, 3, 4, 3)),
    # start, smooth, cov
    *(output_array(axes) for axes in (3, 3, 4)),
)
def carry_adjoints_back(
    dt: Array,
    encoders: Array,
    encoder_var: Array,
    y: Array,
    jac: Array,
    reset: Array,
    move: Array,
    order: int,
    length: int,
    information: Array,
    gains: Array,
    weights: Array,
    z: Array,
    p: Array,
    end: Array,
    start: Array,
    smooth: Array,
    cov: Array,
) -> None:
    """Carry the adjoints, or W and Ψ, at the end of every stretch back to its start."""
    joints, shared = encoders.shape[1:]
    tracks, rows = y.shape[1:3]
    states, width, stretches = end.shape
    square = width > 1
    offsets = states > order * joints
    outputs = cov.shape[1]
    share = np.empty(stretches, np.int64)
    step = np.empty(stretches)
    noise = np.empty(stretches)
    motion = np.empty((states // joints, states // joints))
    old = np.empty(states // joints)
    gain = np.empty((states, stretches))
    weight = np.empty(stretches)
    slope = np.empty((joints, stretches))
    total = np.empty((width, stretches))
    scale = np.empty(stretches)
    output_rows = np.empty((outputs, states, stretches))
    half = np.empty((outputs, states, stretches))
    known = np.empty((states, width, stretches))
    for c in range(stretches):
        share[c] = c // (stretches // shared)
        for a in range(states):
            for b in range(width):
                known[a, b, c] = end[a, b, c]
    for i in range(length - 1, -1, -1):
        for c in range(stretches):
            step[c] = dt[i, share[c]]
        if cov.size > 0:
            smooth_covariances(known, i, joints, order * joints, p, cov, output_rows, half)
        if not square:
            smooth_means(known, i, joints, z, p, smooth)
            undo_encoder_readings(known, i, share, encoders, information, smooth, offsets)
            undo_track_readings(known, i, share, y, jac, information, smooth)
        else:  # the encoders came after the tracks
            for j in range(joints - 1, -1, -1):
                if take_reading(gains, weights, i, j, gain, weight):
                    off = order * joints + j if offsets else j
                    for c in range(stretches):
                        noise[c] = encoder_var[i, j, share[c]]
                    undo_encoder_row(known, gain, weight, j, off, noise, total, scale)
            for row in range(tracks * rows - 1, -1, -1):
                if take_reading(gains, weights, i, joints + row, gain, weight):
                    for j in range(joints):
                        for c in range(stretches):
                            slope[j, c] = jac[i, row // rows, row % rows, j, share[c]]
                    undo_track_row(known, gain, weight, slope, total, scale)
        if reset.size > 0:
            for j in range(joints):
                for c in range(stretches):
                    if reset[i, j, share[c]]:
                        undo_restart(known, square, j, joints, order, c)
        if has_own_motion(move, i):
            for j in range(joints):
                for c in range(stretches):
                    choose_motion(move, i, j, share[c], step[c], order, motion)
                    undo_joint_motion(known, square, j, joints, c, motion, old)
        else:
            undo_motion(known, square, joints, order, step)
        if square:
            make_symmetric(known)
    for c in range(stretches):
        for a in range(states):
            for b in range(width):
                start[a, b, c] = known[a, b, c]


# One joint's encoder readings alone, for many ratios of process to noise side by side.


@declare_kernel(
    # dt, y, ratio, fresh, counts, order, vague, usual, squares, logs, lag
    *(input_array(1), input_array(1), input_array(1), input_flags(1), input_flags(1)),
    whole,
    number,
    number,
    *(output_array(1), output_array(1), output_array(1)),
)
def weigh_noise_ratios(
    dt: Array,
    y: Array,
    ratio: Array,
    fresh: Array,
    counts: Array,
    order: int,
    vague: float,
    usual: float,
    squares: Array,
    logs: Array,
    lag: Array,
) -> None:
    """Filter readings of noise 1 with each ratio as the process noise.

    Sums (R,) of the squared innovations over their variances and of the variances' logarithms; the
    largest innovation of which the next one reaches a quarter, on the same side. A filter restarts
    where `fresh` with the variance `vague`, divided by the square of the `usual` dt for each
    derivative.
    """
    for r in range(len(ratio)):
        x0 = x1 = x2 = 0.0
        p00 = p01 = p02 = p11 = p12 = p22 = 0.0
        squares[r] = logs[r] = lag[r] = before = 0.0
        product = 1.0
        for i in range(len(dt)):
            if fresh[i]:
                x0 = y[i]
                x1 = 0.0
                x2 = 0.0
                p00 = vague
                p11 = vague / (usual * usual)
                p22 = p11 / (usual * usual) if order == 3 else 0.0
                p01 = p02 = p12 = 0.0
            else:
                step = dt[i]
                half = 0.5 * step * step
                x0 = x0 + step * x1 + half * x2
                x1 = x1 + step * x2
                # rows 0 and 1 of F P, and then the upper triangle of F P Fᵀ
                f00 = p00 + step * p01 + half * p02
                f01 = p01 + step * p11 + half * p12
                f02 = p02 + step * p12 + half * p22
                f11 = p11 + step * p12
                f12 = p12 + step * p22
                once = ratio[r] * step
                if order == 3:
                    thrice = once * step * step
                    p00 = f00 + step * f01 + half * f02 + thrice * step * step * (1 / 20)
                    p01 = f01 + step * f02 + thrice * step * (1 / 8)
                    p02 = f02 + thrice * (1 / 6)
                    p11 = f11 + step * f12 + thrice * (1 / 3)
                    p12 = f12 + once * step * (1 / 2)
                    p22 = p22 + once
                else:
                    p00 = f00 + step * f01 + once * step * step * (1 / 3)
                    p01 = f01 + once * step * (1 / 2)
                    p11 = f11 + once
            off = y[i] - x0
            size = p00 + 1.0
            gain0 = p00 / size
            gain1 = p01 / size
            gain2 = p02 / size
            x0 += gain0 * off
            x1 += gain1 * off
            x2 += gain2 * off
            p11 -= gain1 * p01
            p12 -= gain1 * p02
            p22 -= gain2 * p02
            p00 = gain0
            p01 = gain1
            p02 = gain2
            if counts[i]:
                off /= math.sqrt(size)
                product *= size
            else:
                off = 0.0
            if i % READINGS_AT_ONCE == READINGS_AT_ONCE - 1 or i == len(dt) - 1:
                logs[r] += math.log(product)
                product = 1.0
            squares[r] += off * off
            # the least of four times this one and the one before, on the same side
            lag[r] = max(lag[r], min(before, 4.0 * off), -max(before, 4.0 * off))
            before = off
