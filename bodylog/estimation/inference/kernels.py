"""The loops over instants, which Numba compiles: the filter, the two backward passes of the
smoother, and the evidence of one joint's encoder readings.

Shapes of the arrays are in filter_pass.py, solution.py and encoder_noise.py; one that is absent has
the size 0. The belief is a matrix (K,K+1): the covariance, beside the mean. A product of a row h
with it is h P and the predicted reading, so both are updated at once. What is absent at an instant
is NaN.

All of it stands in this file, because the cache of machine code notices changes of no other one.
"""

import math
from typing import NamedTuple

import numpy as np

from ...types import Array
from .compiler import (
    compile_inner,
    declare_kernel,
    input_array,
    input_flags,
    number,
    output_array,
    record_of,
    whole,
)

TWO_PI = 2.0 * math.pi
READINGS_AT_ONCE = 16
"""Variances, in units of the noise, of which one logarithm is taken."""
NOISE_SHARES = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
"""1/((2p−1−i−j) (p−1−i)! (p−1−j)!) of order p = 3; those of order 2 are its lower right part."""


class ReadingArrays(NamedTuple):
    """The readings of all instants, and how joints move before them: those of `FilterReadings`."""

    dt: Array
    encoders: Array
    encoder_var: Array
    y: Array
    jac: Array
    var: Array
    reset: Array
    process_factor: Array
    move: Array
    shift: Array
    noise: Array


class MotionArrays(NamedTuple):
    """process, drift, counted (M,) of `FilterDynamics` and the variances restart (O,) of a joint
    that restarts.
    """

    process: Array
    drift: Array
    counted: Array
    restart: Array


class OutlierLimits(NamedTuple):
    """Gate in standard deviations; cost of an outlier there and, far off, beside it (nats)."""

    gate: float
    outlier_cost: float
    flat: float


class TraceArrays(NamedTuple):
    """What is kept of each instant: the arrays of `FilterTrace`."""

    prior: Array
    prior_cov: Array
    z: Array
    cov: Array
    end_p: Array
    nats: Array
    encoder_d: Array
    p: Array
    information: Array
    gains: Array
    weights: Array
    marks: Array


class Workspace(NamedTuple):
    """Room for an instant, of S states a joint and of T tracks with D rows.

    growth (O,O), motion (S,S), old (S,): of the motion · encoder_noise (M,), seen
    (T,D), track_noise (T,D), sees (T,): its readings · projected (D,K+1), cross (D,D), off (D,),
    system (D,D): of one track · read_by_encoder (K+1,): of one encoder.
    """

    growth: Array
    motion: Array
    old: Array
    encoder_noise: Array
    seen: Array
    track_noise: Array
    sees: Array
    projected: Array
    cross: Array
    off: Array
    system: Array
    read_by_encoder: Array


# Motion of joints: white noise in their highest derivative, as in motion.py, or a motion of their
# own.


@compile_inner
def integrate_noise(dt: float, order: int, growth: Array) -> None:
    """Write into growth (O,O) the covariance that white noise of density 1 adds in dt."""
    for r in range(order):
        for q in range(order):
            growth[r, q] = dt * NOISE_SHARES[3 - order + r, 3 - order + q]
            for _ in range(2 * order - 2 - r - q):
                growth[r, q] *= dt


@compile_inner
def choose_motion(move: Array, i: int, j: int, dt: float, order: int, motion: Array) -> bool:
    """Write a joint's motion before instant i into motion (S,S); whether it is its own, and not by
    Taylor's series.
    """
    own = move.size > 0 and not math.isnan(move[i, 0, 0, j])
    for r in range(len(motion)):
        for q in range(len(motion)):
            if own:
                motion[r, q] = move[i, r, q, j]
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
def move_joint(belief: Array, j: int, joints: int, motion: Array, old: Array) -> None:
    """Multiply rows and columns of a joint's states by motion (S,S); old (S,): room."""
    states, width = belief.shape
    for b in range(width):
        for r in range(len(old)):
            old[r] = belief[r * joints + j, b]
        for r in range(len(old)):
            moved = motion[r, 0] * old[0]
            for q in range(1, len(old)):
                moved += motion[r, q] * old[q]
            belief[r * joints + j, b] = moved
    for a in range(states):
        for r in range(len(old)):
            old[r] = belief[a, r * joints + j]
        for r in range(len(old)):
            moved = motion[r, 0] * old[0]
            for q in range(1, len(old)):
                moved += motion[r, q] * old[q]
            belief[a, r * joints + j] = moved


@compile_inner
def mirror_upper_triangle(square: Array) -> None:
    """Fill the lower triangle, so that rounding leaves the matrix symmetric."""
    for a in range(1, len(square)):
        for b in range(a):
            square[a, b] = square[b, a]


@compile_inner
def move_belief(
    belief: Array, i: int, readings: ReadingArrays, model: MotionArrays, room: Workspace
) -> None:
    """Move the belief to instant i with process noise and the walk of offsets, or by a joint's own
    motion, shift and noise.
    """
    dt = readings.dt[i]
    states = len(belief)
    joints = len(model.process)
    order = len(model.restart)
    growth = room.growth
    motion = room.motion
    integrate_noise(dt, order, growth)
    for j in range(joints):
        density = model.process[j]
        if readings.process_factor.size > 0:
            density *= readings.process_factor[i, j]
        own = choose_motion(readings.move, i, j, dt, order, motion)
        move_joint(belief, j, joints, motion, room.old)
        for r in range(len(motion)):
            at = r * joints + j
            if own:
                belief[at, states] += readings.shift[i, r, j]
            for q in range(len(motion)):
                if own:
                    belief[at, q * joints + j] += readings.noise[i, r, q, j]
                elif r < order and q < order:
                    belief[at, q * joints + j] += density * growth[r, q]
                elif r == q:
                    belief[at, at] += model.drift[j] * dt
    mirror_upper_triangle(belief)


@compile_inner
def restart_joint(
    belief: Array, j: int, joints: int, variances: Array, dt: float, reading: float
) -> None:
    """Give a joint's states the prior variances (O,), but for its offset.

    Its angle is that of the reading or, without one, that before dt.
    """
    states = len(belief)
    order = len(variances)
    angle = belief[j, states] - dt * belief[joints + j, states]
    if order == 3:
        angle += 0.5 * dt * dt * belief[2 * joints + j, states]
    if math.isfinite(reading):
        angle = reading
        if states > order * joints:
            angle -= belief[order * joints + j, states]
    for r in range(order):
        at = r * joints + j
        for a in range(states):
            belief[at, a] = 0.0
            belief[a, at] = 0.0
        belief[at, states] = 0.0
        belief[at, at] = variances[r]
    belief[j, states] = angle


# The belief given the readings of an instant, gated by the prior, so that their order does not
# matter.


@compile_inner
def condition_belief(belief: Array, projected: Array, weight: float) -> None:
    """Condition on a reading with the inverse variance `weight`.

    projected (K+1,): P hᵀ, followed by minus the innovation.
    """
    for a in range(len(belief)):
        for b in range(len(projected)):
            belief[a, b] -= projected[a] * projected[b] * weight


@compile_inner
def compute_innovation_nats(innovation: float, weight: float) -> float:
    """Nats of a reading's innovation, of the inverse variance `weight`."""
    return 0.5 * (innovation * innovation * weight + math.log(TWO_PI / weight))


@compile_inner
def keep_reading(
    projected: Array, weight: float, noise: float, i: int, reading: int, trace: TraceArrays
) -> None:
    """Keep what a smoother needs of a reading: information, and weight and gain."""
    if trace.information.size > 0:
        trace.information[i, reading] = 1.0 / noise
    if trace.weights.size > 0:
        trace.weights[i, reading] = weight
        for a in range(len(projected) - 1):
            trace.gains[i, reading, a] = projected[a] * weight


@compile_inner
def project_track(
    belief: Array, jac: Array, seen: Array, i: int, track: int, projected: Array, cross: Array
) -> None:
    """Project the belief on a track's rows h, seen (D,) or NaN.

    Writes P Hᵀ and minus the innovation into projected (D,K+1), and H P Hᵀ into cross (D,D).
    """
    rows, joints = jac.shape[2:]
    for d in range(rows):
        for b in range(projected.shape[1]):
            projected[d, b] = 0.0
        for j in range(joints):
            slope = jac[i, track, d, j]
            for b in range(projected.shape[1]):
                projected[d, b] += slope * belief[j, b]
        innovation = seen[d] - projected[d, -1]
        projected[d, -1] = 0.0 if math.isnan(innovation) else -innovation
    for d in range(rows):
        for e in range(rows):
            cross[d, e] = 0.0
            for j in range(joints):
                cross[d, e] += jac[i, track, e, j] * projected[d, j]


@compile_inner
def square_innovation(
    projected: Array, cross: Array, noise: Array, off: Array, system: Array
) -> tuple[float, float]:
    """The squared innovation over its covariance H P Hᵀ + R, and the determinant.

    projected (D,K+1), cross (D,D): of project_track · noise (D,): R · off (D,), system (D,D): room.
    """
    square = 0.0
    size = 1.0
    for e in range(len(off)):
        off[e] = projected[e, -1]
        for d in range(len(off)):
            system[e, d] = cross[e, d]
        system[e, e] += noise[e]
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
    projected: Array, cross: Array, limits: OutlierLimits, noise: Array, off: Array, system: Array
) -> float:
    """Inflate the noise (D,) of a track's rows that are outliers; the nats that these cost."""
    square, size = square_innovation(projected, cross, noise, off, system)
    over = square / (limits.gate * limits.gate)
    if not over > 1.0:
        return 0.0
    for d in range(len(noise)):
        noise[d] += (cross[d, d] + noise[d]) * (over * over - 1.0)
    inflated, wide_size = square_innovation(projected, cross, noise, off, system)
    half_log = 0.5 * math.log(wide_size / size)
    beyond = limits.flat * (1.0 - 1.0 / over)
    return limits.outlier_cost + beyond - 0.5 * inflated - half_log


@compile_inner
def eliminate_row(projected: Array, cross: Array, d: int, weight: float) -> None:
    """Make the later rows of a track independent of its row d, of inverse variance `weight`."""
    rows, width = projected.shape
    for e in range(d + 1, rows):
        factor = weight * cross[d, e]
        for b in range(width):
            projected[e, b] -= factor * projected[d, b]
        for f in range(rows - 1, e - 1, -1):
            cross[e, f] -= factor * cross[d, f]


@compile_inner
def gate_encoder(
    belief: Array, reading: float, j: int, offset: int, limits: OutlierLimits, noise: float
) -> tuple[float, float, float]:
    """The innovation of a reading in standard deviations; its noise, inflated if it is an outlier,
    and the nats that this costs.

    offset: state of the encoder's offset, or −1.
    """
    cost = limits.outlier_cost
    innovation = reading - belief[j, -1]
    total = belief[j, j] + noise
    if offset >= 0:
        total += belief[offset, offset] + 2.0 * belief[j, offset]
        innovation -= belief[offset, -1]
    total = max(noise, total)  # rounding after a reading far surer than the belief
    deviation = innovation / math.sqrt(total)
    over = deviation * deviation / (limits.gate * limits.gate)
    if not over > 1.0:
        return deviation, noise, 0.0
    nats = cost + limits.flat * (1.0 - 1.0 / over) - cost / over - math.log(over)
    return deviation, noise + total * (over * over - 1.0), nats


@compile_inner
def project_encoder(
    belief: Array, reading: float, j: int, offset: int, noise: float, projected: Array
) -> float:
    """Project the belief on an encoder's reading; its inverse variance.

    Writes P hᵀ and minus the innovation into projected (K+1,). offset: state of the encoder's
    offset, or −1.
    """
    for b in range(len(projected)):
        projected[b] = belief[j, b]
        if offset >= 0:
            projected[b] += belief[offset, b]
    size = projected[j] + noise
    if offset >= 0:
        size += projected[offset]
    projected[-1] -= reading
    size = max(noise, size)  # rounding, as in gate_encoder
    return float(1.0 / size)


@compile_inner
def take_track(y: Array, var: Array, i: int, track: int, seen: Array, noise: Array) -> bool:
    """Copy a track's rows into seen (D,), NaN where not, and noise (D,); whether any is seen."""
    anything = False
    for d in range(len(seen)):
        seen[d] = y[i, track, d]
        noise[d] = var[i, track, d]
        anything |= not math.isnan(seen[d])
    return anything


# What is kept of the belief.


@compile_inner
def keep_means(belief: Array, i: int, means: Array) -> None:
    """Copy the means of the first states into means (L,…)."""
    for a in range(means.shape[1]):
        means[i, a] = belief[a, -1]


@compile_inner
def keep_covariances(belief: Array, i: int, joints: int, later: int, cov: Array) -> None:
    """Copy covariances of angles and, behind these, of states from `later` on into (L,O,O)."""
    for a in range(cov.shape[1]):
        at = a if a < joints else a - joints + later
        for b in range(cov.shape[1]):
            beside = b if b < joints else b - joints + later
            cov[i, a, b] = belief[at, beside]


@compile_inner
def keep_rows(belief: Array, i: int, joints: int, p: Array) -> None:
    """Copy rows of the covariance into p (L,O,K): all, or those of the angles and offsets."""
    _, rows, states = p.shape
    for r in range(rows):
        a = r if r < joints else states - rows + r
        for b in range(states):
            p[i, r, b] = belief[a, b]


# The filter.


@compile_inner
def restart_joints(belief: Array, i: int, readings: ReadingArrays, variances: Array) -> None:
    """Give the joints that restart at instant i the prior variances (O,)."""
    joints = readings.encoders.shape[1]
    for j in range(joints if readings.reset.size > 0 else 0):
        if readings.reset[i, j]:
            restart_joint(belief, j, joints, variances, readings.dt[i], readings.encoders[i, j])


@compile_inner
def find_offset_state(model: MotionArrays, j: int) -> int:
    """State of an encoder's offset, or −1."""
    return len(model.restart) * len(model.process) + j if len(model.drift) > 0 else -1


@compile_inner
def gate_readings(
    belief: Array,
    i: int,
    readings: ReadingArrays,
    model: MotionArrays,
    limits: OutlierLimits,
    room: Workspace,
    trace: TraceArrays,
) -> None:
    """Take the readings of instant i and their noise, inflated where they are outliers of the
    belief before it.
    """
    for j in range(len(model.process)):
        trace.encoder_d[i, j] = math.nan
        room.encoder_noise[j] = readings.encoder_var[i, j]
        if model.counted[j] and not math.isnan(readings.encoders[i, j]):
            trace.encoder_d[i, j], room.encoder_noise[j], more = gate_encoder(
                belief,
                readings.encoders[i, j],
                j,
                find_offset_state(model, j),
                limits,
                readings.encoder_var[i, j],
            )
            trace.nats[i] += more
    for track in range(len(room.sees)):
        seen = room.seen[track]
        noise = room.track_noise[track]
        room.sees[track] = take_track(readings.y, readings.var, i, track, seen, noise)
        if room.sees[track]:
            project_track(belief, readings.jac, seen, i, track, room.projected, room.cross)
            trace.nats[i] += gate_track(
                room.projected, room.cross, limits, noise, room.off, room.system
            )


@compile_inner
def condition_on_tracks(
    belief: Array, i: int, readings: ReadingArrays, room: Workspace, trace: TraceArrays
) -> None:
    """Condition the belief on the tracks' rows at instant i."""
    tracks, rows = room.seen.shape
    joints = readings.encoders.shape[1]
    for track in range(tracks):
        if not room.sees[track]:
            continue
        seen = room.seen[track]
        project_track(belief, readings.jac, seen, i, track, room.projected, room.cross)
        for d in range(rows):
            if math.isnan(seen[d]):
                continue
            projected = room.projected[d]
            noise = room.track_noise[track, d]
            weight = 1.0 / (room.cross[d, d] + noise)
            eliminate_row(room.projected, room.cross, d, weight)
            trace.nats[i] += compute_innovation_nats(projected[-1], weight)
            condition_belief(belief, projected, weight)
            keep_reading(projected, weight, noise, i, joints + track * rows + d, trace)


@compile_inner
def condition_on_encoders(
    belief: Array,
    i: int,
    readings: ReadingArrays,
    model: MotionArrays,
    room: Workspace,
    trace: TraceArrays,
) -> None:
    """Condition the belief on the encoders' readings at instant i."""
    projected = room.read_by_encoder
    for j in range(len(model.process)):
        reading = readings.encoders[i, j]
        if math.isnan(reading):
            continue
        noise = room.encoder_noise[j]
        offset = find_offset_state(model, j)
        weight = project_encoder(belief, reading, j, offset, noise, projected)
        if model.counted[j]:
            trace.nats[i] += compute_innovation_nats(projected[-1], weight)
        condition_belief(belief, projected, weight)
        keep_reading(projected, weight, noise, i, j, trace)


@declare_kernel(
    record_of(
        ReadingArrays,
        *(input_array(axes) for axes in (1, 2, 2, 3, 4, 3)),
        input_flags(2),
        *(input_array(axes) for axes in (2, 4, 3, 4)),
    ),
    record_of(MotionArrays, input_array(1), input_array(1), input_flags(1), input_array(1)),
    record_of(OutlierLimits, number, number, number),
    # block, start_z, start_p
    whole,
    input_array(1),
    input_array(2),
    record_of(TraceArrays, *(output_array(n) for n in (2, 3, 2, 3, 2, 1, 2, 3, 2, 3, 2, 3))),
)
def filter_instants(
    readings: ReadingArrays,
    model: MotionArrays,
    limits: OutlierLimits,
    block: int,
    start_z: Array,
    start_p: Array,
    trace: TraceArrays,
) -> None:
    """Filter a log, one instant after the other, and mark the belief before each block of them."""
    joints = len(model.process)
    order = len(model.restart)
    states = len(start_z)
    own = states // joints
    tracks, rows = readings.y.shape[1:]
    room = Workspace(
        np.empty((order, order)),
        np.empty((own, own)),
        np.empty(own),
        np.empty(joints),
        np.empty((tracks, rows)),
        np.empty((tracks, rows)),
        np.empty(tracks, np.bool_),
        np.empty((rows, states + 1)),
        np.empty((rows, rows)),
        np.empty(rows),
        np.empty((rows, rows)),
        np.empty(states + 1),
    )
    belief = np.empty((states, states + 1))
    belief[:, :states] = start_p
    belief[:, states] = start_z
    for i in range(len(readings.dt)):
        if trace.marks.size > 0 and i % block == 0:
            trace.marks[i // block] = belief
        move_belief(belief, i, readings, model, room)
        restart_joints(belief, i, readings, model.restart)
        keep_means(belief, i, trace.prior)
        keep_covariances(belief, i, joints, joints, trace.prior_cov)
        trace.information[i] = 0.0
        trace.weights[i] = 0.0
        trace.nats[i] = 0.0
        gate_readings(belief, i, readings, model, limits, room, trace)
        condition_on_tracks(belief, i, readings, room, trace)
        condition_on_encoders(belief, i, readings, model, room, trace)
        keep_means(belief, i, trace.z)
        keep_covariances(belief, i, joints, order * joints, trace.cov)
        if trace.p.size > 0:
            keep_rows(belief, i, joints, trace.p)
    trace.end_p[:] = belief[:, :states]


# Back over the log: the adjoint λ (K,) of the means and, in Bryson–Frazier form, the information W
# (K,K).


@compile_inner
def undo_joint_motion(adjoint: Array, j: int, joints: int, motion: Array, old: Array) -> None:
    """Carry an adjoint (K,) back over one joint's motion (S,S); old (S,): room."""
    for r in range(len(old)):
        old[r] = adjoint[r * joints + j]
    for q in range(len(old)):
        moved = motion[0, q] * old[0]
        for r in range(1, len(old)):
            moved += motion[r, q] * old[r]
        adjoint[q * joints + j] = moved


@compile_inner
def smooth_means(adjoint: Array, i: int, joints: int, z: Array, p: Array, smooth: Array) -> None:
    """Write smoothed means z − P λ of the rows that p (L,O,K) holds into smooth (L,O)."""
    _, rows, states = p.shape
    for r in range(rows):
        a = r if r < joints else states - rows + r
        smooth[i, r] = z[i, a]
        for b in range(states):
            smooth[i, r] -= p[i, r, b] * adjoint[b]


@compile_inner
def undo_encoder_readings(
    adjoint: Array, i: int, encoders: Array, information: Array, smooth: Array, offsets: bool
) -> None:
    """Make λ of the encoders' readings λ − hᵀ R⁻¹ (y − h x), where x is the smoothed mean."""
    joints = encoders.shape[1]
    first = len(adjoint) - joints
    for j in range(joints):
        if information[i, j] > 0.0:
            pull = encoders[i, j] - smooth[i, j]
            if offsets:
                pull -= smooth[i, smooth.shape[1] - joints + j]
            pull *= information[i, j]
            adjoint[j] -= pull
            if offsets:
                adjoint[first + j] -= pull


@compile_inner
def undo_track_readings(
    adjoint: Array, i: int, y: Array, jac: Array, information: Array, smooth: Array
) -> None:
    """Make λ of the tracks' rows λ − hᵀ R⁻¹ (y − h x), where x is the smoothed mean."""
    _, tracks, rows, joints = jac.shape
    for track in range(tracks):
        for d in range(rows):
            known = information[i, joints + track * rows + d]
            if known > 0.0:
                pull = y[i, track, d]
                for j in range(joints):
                    pull -= jac[i, track, d, j] * smooth[i, j]
                for j in range(joints):
                    adjoint[j] -= jac[i, track, d, j] * pull * known


@declare_kernel(
    # dt, encoders, y, jac, reset, move
    *(input_array(axes) for axes in (1, 2, 3, 4)),
    input_flags(2),
    input_array(4),
    # order, information, z, p
    whole,
    *(input_array(axes) for axes in (2, 2, 3)),
    # adjoint, smooth
    *(output_array(axes) for axes in (1, 2)),
)
def carry_adjoint_back(
    dt: Array,
    encoders: Array,
    y: Array,
    jac: Array,
    reset: Array,
    move: Array,
    order: int,
    information: Array,
    z: Array,
    p: Array,
    adjoint: Array,
    smooth: Array,
) -> None:
    """Carry the adjoint at the end of a log back to its start, and write the smoothed means."""
    joints = encoders.shape[1]
    states = len(adjoint)
    motion = np.empty((states // joints, states // joints))
    old = np.empty(states // joints)
    for i in range(len(dt) - 1, -1, -1):
        smooth_means(adjoint, i, joints, z, p, smooth)
        undo_encoder_readings(adjoint, i, encoders, information, smooth, states > order * joints)
        undo_track_readings(adjoint, i, y, jac, information, smooth)
        for j in range(joints):
            for r in range(order if reset.size > 0 and reset[i, j] else 0):
                adjoint[r * joints + j] = 0.0  # its states depend on nothing before
            choose_motion(move, i, j, dt[i], order, motion)
            undo_joint_motion(adjoint, j, joints, motion, old)


@compile_inner
def weigh_rows(known: Array, gain: Array, row: int, off: int, total: Array) -> None:
    """Write gᵀ W, without the states `row` and `off`, into total (K,)."""
    for b in range(len(total)):
        total[b] = 0.0
    for a in range(len(known)):
        if a not in (row, off):
            for b in range(len(total)):
                total[b] += gain[a] * known[a, b]


@compile_inner
def undo_track_row(
    known: Array, gain: Array, weight: float, jac: Array, i: int, track: int, d: int, total: Array
) -> None:
    """Make W (I − g h)ᵀ W (I − g h) + weight hᵀ h, of a track's row h; total (K,): room."""
    joints = jac.shape[3]
    weigh_rows(known, gain, -1, -1, total)
    curve = weight
    for a in range(len(known)):
        curve += gain[a] * total[a]
    for j in range(joints):
        slope = jac[i, track, d, j]
        for b in range(len(known)):
            known[j, b] -= slope * total[b]
        for a in range(len(known)):
            known[a, j] -= total[a] * slope
        for b in range(joints):
            known[j, b] += slope * curve * jac[i, track, d, b]


@compile_inner
def undo_encoder_columns(
    known: Array, gain: Array, weight: float, row: int, off: int, at: int, left: float
) -> None:
    """Carry back the columns of an encoder's states in the row `at` of W; see undo_encoder_row."""
    both = 1.0 if off != row else 0.0
    rest = 0.0
    for a in range(len(known)):
        if a not in (row, off):
            rest += gain[a] * known[at, a]
    across = both * (known[at, off] - known[at, row])
    angle = left * known[at, row] - rest - gain[off] * across + weight
    known[at, off] = left * known[at, off] - rest + gain[row] * across + weight
    known[at, row] = angle


@compile_inner
def undo_encoder_row(
    known: Array, gain: Array, weight: float, row: int, off: int, noise: float, total: Array
) -> None:
    """Carry W back over an encoder, which reads the angle `row` and the offset `off`, as
    undo_track_row does; off = row: no offset.

    1 − h g = R weight of an exact reading is far below the rounding of h g, and W is as much
    larger, so that it is not taken from a difference. total (K,): room.
    """
    states = len(known)
    both = 1.0 if off != row else 0.0
    left = max(weight * noise, 1.0 - gain[row] - both * gain[off])
    weigh_rows(known, gain, row, off, total)
    for b in range(states):
        across = both * (known[off, b] - known[row, b])
        angle = left * known[row, b] - total[b] - gain[off] * across
        known[off, b] = left * known[off, b] - total[b] + gain[row] * across
        known[row, b] = angle
    undo_encoder_columns(known, gain, weight, row, off, row, left)
    if off != row:
        undo_encoder_columns(known, gain, weight, row, off, off, left)
    for a in range(states):
        if a not in (row, off):
            known[a, row] = known[row, a]
            known[a, off] = known[off, a]


@compile_inner
def smooth_covariances(
    known: Array, i: int, joints: int, offset: int, p: Array, cov: Array, rows: Array, half: Array
) -> None:
    """Write P − P W P of the angles and, behind these, of what encoders with offsets read, into
    cov (L,O,O).

    offset: state of the first offset · rows (O,K), half (O,K): room.
    """
    outputs, states = rows.shape
    for r in range(outputs):
        for a in range(states):
            rows[r, a] = p[i, r % joints, a]
            if r >= joints:
                rows[r, a] += p[i, offset + r % joints, a]
            half[r, a] = 0.0
    for r in range(outputs):
        for a in range(states):
            for b in range(states):
                half[r, b] += rows[r, a] * known[a, b]
    for r in range(outputs):
        for q in range(outputs):
            cov[i, r, q] = rows[r, q % joints]
            if q >= joints:
                cov[i, r, q] += rows[r, offset + q % joints]
            for a in range(states):
                cov[i, r, q] -= half[r, a] * rows[q, a]


@compile_inner
def make_symmetric(known: Array) -> None:
    """Make W the mean of itself and its transpose."""
    for a in range(len(known)):
        for b in range(a):
            mean = 0.5 * (known[a, b] + known[b, a])
            known[a, b] = mean
            known[b, a] = mean


@declare_kernel(
    # dt, encoder_var, jac, reset, move
    *(input_array(axes) for axes in (1, 2, 4)),
    input_flags(2),
    input_array(4),
    # order, gains, weights, p
    whole,
    *(input_array(axes) for axes in (3, 2, 3)),
    # known, cov
    *(output_array(axes) for axes in (2, 3)),
)
def carry_information_back(
    dt: Array,
    encoder_var: Array,
    jac: Array,
    reset: Array,
    move: Array,
    order: int,
    gains: Array,
    weights: Array,
    p: Array,
    known: Array,
    cov: Array,
) -> None:
    """Carry the information W at the end of a log back to its start, and write the smoothed
    covariances.
    """
    joints = encoder_var.shape[1]
    tracks, rows = jac.shape[1:3]
    states = len(known)
    offsets = states > order * joints
    motion = np.empty((states // joints, states // joints))
    old = np.empty(states // joints)
    total = np.empty(states)
    output_rows = np.empty((cov.shape[1], states))
    half = np.empty((cov.shape[1], states))
    for i in range(len(dt) - 1, -1, -1):
        smooth_covariances(known, i, joints, order * joints, p, cov, output_rows, half)
        for j in range(joints - 1, -1, -1):  # the encoders came after the tracks
            if weights[i, j] > 0.0:
                off = order * joints + j if offsets else j
                noise = encoder_var[i, j]
                undo_encoder_row(known, gains[i, j], weights[i, j], j, off, noise, total)
        for row in range(tracks * rows - 1, -1, -1):
            weight = weights[i, joints + row]
            if weight > 0.0:
                gain = gains[i, joints + row]
                undo_track_row(known, gain, weight, jac, i, row // rows, row % rows, total)
        for j in range(joints):
            for r in range(order if reset.size > 0 and reset[i, j] else 0):
                known[r * joints + j, :] = 0.0  # its states depend on nothing before
                known[:, r * joints + j] = 0.0
            choose_motion(move, i, j, dt[i], order, motion)
            for b in range(states):
                undo_joint_motion(known[:, b], j, joints, motion, old)
            for a in range(states):
                undo_joint_motion(known[a], j, joints, motion, old)
        make_symmetric(known)


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
        x0 = 0.0
        x1 = 0.0
        x2 = 0.0
        p00 = 0.0
        p01 = 0.0
        p02 = 0.0
        p11 = 0.0
        p12 = 0.0
        p22 = 0.0
        squares[r] = 0.0
        logs[r] = 0.0
        lag[r] = 0.0
        before = 0.0
        product = 1.0
        for i in range(len(dt)):
            if fresh[i]:
                x0 = y[i]
                x1 = 0.0
                x2 = 0.0
                p00 = vague
                p11 = vague / (usual * usual)
                p22 = p11 / (usual * usual) if order == 3 else 0.0
                p01 = 0.0
                p02 = 0.0
                p12 = 0.0
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
