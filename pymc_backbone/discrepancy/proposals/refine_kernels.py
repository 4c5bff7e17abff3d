"""Compiled: level values fitted by looks and a given defect, each specimen with values of its own."""

from __future__ import annotations

import math

import numpy as np

from ..._common.checks import BoolArray, FloatArray, IntArray
from ..._common.compiled import ahead, cached
from ...simulation.curves import compiled
from ...simulation.forces import ROOM, ROW
from ...simulation.memory import DAMPING as DAMPING_PLACE
from ...simulation.memory import MASS, N_EFFECTS, TABLE
from ...simulation.memory import STIFFNESS as STIFFNESS_PLACE
from ..fitting.layout import MOST_OPPOSED
from ..fitting.small_systems import solve_in_place
from .look_kernels import AT_TURN, DAMPING, MIDDLE, N_LOOK, STIFFNESS, averaged

_LONGEST = 1.0  # step of the logarithm of a shape
_LARGEST_PART = 0.5  # step of any other shape, in parts of its size


@compiled
def _physical(
    template: FloatArray, free: IntArray, powers: IntArray, slips: IntArray, opposed: IntArray, amplitude: float,
    low: FloatArray, high: FloatArray, eta: FloatArray, vector: FloatArray,
) -> None:  # fmt: skip
    """Write the parameter vector of the shared coordinates, as `Layout.physical` does."""
    for j in range(template.size):
        vector[j] = template[j]
    values = np.minimum(np.maximum(eta, low), high)
    for i in range(opposed.shape[0]):
        j, other = opposed[i]
        values[j] = min(max(values[j], -values[other]), MOST_OPPOSED * values[other])
    for i in range(powers.shape[0]):
        j, exponent = powers[i]
        values[j] *= amplitude ** -values[exponent]
    for i in range(slips.shape[0]):
        j, force = slips[i]
        strength = values[j]
        values[j] = strength / (values[force] * amplitude)
        values[force] = strength
    for i in range(free.size):
        vector[free[i]] = values[i]


@cached
def observe(look: FloatArray, level: int, mass: float, stiffer: float, damper: float, out: FloatArray) -> bool:
    """Write frequency, damping, mid-line, and how the first two change with stiffness, damping, force at the turn.

    ``out``: f, delta, offset, f_K, f_C, delta_K, delta_C, delta_F.
    """
    stiff = look[level, STIFFNESS] + stiffer
    damp = look[level, DAMPING] + damper
    turn = look[level, AT_TURN] + stiffer
    square = stiff / mass - 0.25 * (damp / mass) ** 2
    if not (square > 0.0 and turn > 0.0):
        return False
    omega = math.sqrt(square)
    out[0] = omega / (2.0 * math.pi)
    out[1] = math.pi * damp * omega / turn
    out[2] = look[level, MIDDLE]
    out[3] = 0.5 * out[0] / (square * mass)
    out[4] = -0.25 * out[0] * damp / (mass * mass * square)
    out[5] = 0.5 * out[1] / (square * mass)
    out[6] = math.pi * omega / turn - 0.25 * out[1] * damp / (mass * mass * square)
    out[7] = -out[1] / turn
    return True


@compiled
def _equations(
    look: FloatArray, slopes: FloatArray, levels: FloatArray, mass: float, centre: FloatArray, own: FloatArray,
    scatter: float, eta: FloatArray, count: IntArray, rows: IntArray, values: FloatArray, whitening: FloatArray,
    defect: FloatArray, tilt: FloatArray, origin: FloatArray, shared: FloatArray, gradient: FloatArray,
    solutions: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Write the normal equations of the shared coordinates, each specimen's own eliminated; return the cost left.

    ``tilt`` (q, 3, l) are the derivatives of the defect, which is that at ``origin``. ``solutions`` (r, 2, q + 1) hold
    what the own stiffness and damping do, as functions of the shared step.
    """
    q = eta.size
    shared[:] = 0.0
    gradient[:] = 0.0
    cost, log_determinant = 0.0, 0.0
    out = np.zeros(8)
    for r in range(own.shape[0]):
        m = count[r]
        raw = np.zeros((m, 3 + q))
        zero = np.zeros(m)
        stiffer, damper = own[r, 0] - centre[0], own[r, 1] - centre[1]
        for i in range(m):
            o, level = rows[r, i]
            if not observe(look, level, mass, stiffer, damper, out):
                return np.inf, 0.0
            if o == 0:
                raw[i, 0], raw[i, 1] = out[3], out[4]
                for j in range(q):
                    raw[i, 2 + j] = out[3] * slopes[j, level, STIFFNESS] + out[4] * slopes[j, level, DAMPING]
            elif o == 1:
                raw[i, 0], raw[i, 1] = out[5] + out[7], out[6]
                for j in range(q):
                    raw[i, 2 + j] = (
                        out[5] * slopes[j, level, STIFFNESS]
                        + out[6] * slopes[j, level, DAMPING]
                        + out[7] * slopes[j, level, AT_TURN]
                    )
            else:
                zero[i] = levels[0] / levels[level]
                for j in range(q):
                    raw[i, 2 + j] = slopes[j, level, MIDDLE]
            raw[i, 2 + q] = values[r, i] - out[o] - defect[r, o, level]
            for j in range(q):
                raw[i, 2 + j] += tilt[j, o, level]
                raw[i, 2 + q] -= tilt[j, o, level] * (eta[j] - origin[j])
        white = np.ascontiguousarray(whitening[r, :m, :m]) @ raw
        # own: stiffness, damping, the scatter of each coordinate with its standard normal prior, the sensor's zero
        size = 3 + q
        local = np.zeros((m, size))
        local[:, :2] = white[:, :2]
        local[:, 2 + q] = np.ascontiguousarray(whitening[r, :m, :m]) @ zero
        for j in range(q):
            local[:, 2 + j] = white[:, 2 + j] * (scatter * eta[j])
        is_held = own[r, 1] <= 0.0
        residual = np.ascontiguousarray(white[:, 2 + q])
        block = np.zeros((size, size))
        block[:, :] = local.T @ local
        for j in range(q):
            block[2 + j, 2 + j] += 1.0
        if block[2 + q, 2 + q] == 0.0:
            block[2 + q, 2 + q] = 1.0
        pull = local.T @ residual
        mixed = np.ascontiguousarray(white[:, 2 : 2 + q])
        right = np.zeros((size, q + 1))
        right[:, :q] = local.T @ mixed
        right[:, q] = pull
        if is_held and pull[1] < 0.0:
            block[1, :] = 0.0
            block[:, 1] = 0.0
            block[1, 1] = 1.0
            right[1, :] = 0.0
        scale = 1.0 / np.sqrt(np.maximum(np.diag(block), 1e-300))
        for i in range(size):
            for j in range(size):
                block[i, j] *= scale[i] * scale[j]
            block[i, i] += 1e-10
            for j in range(q + 1):
                right[i, j] *= scale[i]
        reduced = right.copy()
        log_determinant += solve_in_place(block, reduced) - 2.0 * np.log(scale).sum()
        cost += (residual * residual).sum() - (right[:, q] * reduced[:, q]).sum()
        shared += mixed.T @ mixed - np.ascontiguousarray(right[:, :q].T) @ np.ascontiguousarray(reduced[:, :q])
        gradient += mixed.T @ residual - np.ascontiguousarray(right[:, :q].T) @ np.ascontiguousarray(reduced[:, q])
        for j in range(q + 1):
            solutions[r, 0, j] = scale[0] * reduced[0, j]
            solutions[r, 1, j] = scale[1] * reduced[1, j]
    return cost, log_determinant


@compiled
def _effect_look(
    alone: IntArray, numbers: FloatArray, row: int, vector: FloatArray, levels: FloatArray, omegas: FloatArray,
    is_asymmetric: BoolArray, rounds: int, points: IntArray, out: FloatArray,
) -> None:  # fmt: skip
    """Write the look (l, 4) of one effect alone; ``alone`` (e, ..) describes each so."""
    averaged(alone[row], numbers, vector, levels, omegas, rounds if is_asymmetric[row] else 1, points[row], out)


@compiled
def _look_at_all(
    alone: IntArray, numbers: FloatArray, vector: FloatArray, levels: FloatArray, omegas: FloatArray,
    is_asymmetric: BoolArray, rounds: int, points: IntArray, strengths: IntArray, eta: FloatArray, centre: FloatArray,
    known_eta: FloatArray, known: FloatArray, looks: FloatArray, look: FloatArray,
) -> None:  # fmt: skip
    """Write the looks (e, l, 4) of all effects, and that of everything together: the mean specimen and all effects.

    ``strengths`` (e,) are the coordinates that effects are in proportion to, -1 where they are not: these are taken
    from the looks ``known`` at ``known_eta``.
    """
    for level in range(look.shape[0]):
        look[level, STIFFNESS] = centre[0]
        look[level, DAMPING] = centre[1]
        look[level, AT_TURN] = centre[0]
        look[level, MIDDLE] = 0.0
    for e in range(looks.shape[0]):
        j = strengths[e]
        if j >= 0 and known_eta[j] != 0.0:
            looks[e] = known[e] * (eta[j] / known_eta[j])
        else:
            _effect_look(alone, numbers, e, vector, levels, omegas, is_asymmetric, rounds, points, looks[e])
        look += looks[e]


@compiled
def _each_alone(integers: IntArray) -> IntArray:
    """Return the description of each effect without the others."""
    n = integers[N_EFFECTS]
    alone = np.zeros((n, TABLE + ROW + ROOM), np.int64)
    for e in range(n):
        alone[e, :TABLE] = integers[:TABLE]
        alone[e, TABLE:] = np.append(integers[TABLE + ROW * e :][:ROW], integers[TABLE + ROW * n + ROOM * e :][:ROOM])
    alone[:, N_EFFECTS] = 1
    return alone


@ahead("i1 f1 f1 i1 i2 i2 i2 f1 f1 b1 f1 f i1 b1 b1 b1 f1 f1 i i1 i1 i3 f2 f3 f3 f3 f1 f i f f1 f2 f2 f2 f3")
@cached
def refine(
    integers: IntArray, numbers: FloatArray, template: FloatArray, free: IntArray, powers: IntArray,
    slips: IntArray, opposed: IntArray, low: FloatArray, high: FloatArray, is_log: BoolArray, widths: FloatArray,
    amplitude: float, owners: IntArray, is_strength: BoolArray, is_asymmetric: BoolArray, is_proportional: BoolArray,
    levels: FloatArray, omegas: FloatArray, rounds: int, points: IntArray, count: IntArray, rows: IntArray,
    values: FloatArray, whitening: FloatArray, defect: FloatArray, tilt: FloatArray, origin: FloatArray,
    scatter: float, iterations: int, tolerance: float, eta: FloatArray, own: FloatArray, look: FloatArray,
    shared: FloatArray, slopes: FloatArray,
) -> tuple[float, float]:  # fmt: skip
    """Fit shared coordinates and own stiffness and damping to the level values by looks and a given defect.

    ``defect`` (r, 3, l) is what looks lack where the coordinates are ``origin`` (q,), ``tilt`` (q, 3, l) are its
    derivatives. ``owners`` (q,) are the rows of the table that coordinates belong to; ``is_asymmetric``,
    ``is_proportional`` (to its only coordinate) and ``points`` (e,) say how each effect is looked at. ``eta`` (q,) and
    ``own`` (r, 2) are moved in place; ``look`` (l, 4) is that of the mean specimen at the end, ``slopes`` (q, l, 4)
    its derivatives, ``shared`` (q, q) the information on the coordinates. Returns the cost and the logarithm of the
    determinant of the information on the specimens' own values.
    """
    q, effects = eta.size, integers[N_EFFECTS]
    stiffness, damping, mass = integers[STIFFNESS_PLACE], integers[DAMPING_PLACE], numbers[MASS]
    alone = _each_alone(integers)
    vector = np.zeros(template.size)
    looks = np.zeros((effects, levels.size, N_LOOK))
    trials = np.zeros((effects, levels.size, N_LOOK))
    trial = np.zeros((levels.size, N_LOOK))
    gradient, spans = np.zeros(q), np.zeros(q)
    solutions = np.zeros((own.shape[0], 2, q + 1))
    centre = np.zeros(2)
    centre[0], centre[1] = own[:, 0].mean(), own[:, 1].mean()
    _physical(template, free, powers, slips, opposed, amplitude, low, high, eta, vector)
    vector[stiffness], vector[damping] = 0.0, 0.0
    strengths = np.full(effects, -1)
    for j in range(q):
        if is_proportional[owners[j]]:
            strengths[owners[j]] = j
    _look_at_all(
        alone, numbers, vector, levels, omegas, is_asymmetric, rounds, points, strengths, eta, centre, np.zeros(q),
        trials, looks, look,
    )  # fmt: skip
    marquardt = 1e-3
    cost, log_determinant = np.inf, 0.0
    quiet, is_new = 0, True
    for iteration in range(iterations + 1):
        if is_new:
            for j in range(q):
                spans[j] = abs(eta[j])
            for i in range(opposed.shape[0]):
                spans[opposed[i, 0]] = max(spans[opposed[i, 0]], abs(eta[opposed[i, 1]]))
            for j in range(q):
                e = owners[j]
                kept = eta[j]
                if is_strength[j] and not is_asymmetric[e] and abs(kept) > 1e-9 * widths[j]:
                    slopes[j] = looks[e] / kept
                    continue
                width = 5e-3 * kept if is_log[j] else 1e-3 * max(spans[j], 1e-2 * widths[j])
                if kept + width > high[j]:
                    width = -width
                eta[j] = kept + width
                _physical(template, free, powers, slips, opposed, amplitude, low, high, eta, vector)
                vector[stiffness], vector[damping] = 0.0, 0.0
                _effect_look(alone, numbers, e, vector, levels, omegas, is_asymmetric, rounds, points, trial)
                eta[j] = kept
                slopes[j] = (trial - looks[e]) / width
            cost, log_determinant = _equations(
                look, slopes, levels, mass, centre, own, scatter, eta, count, rows, values, whitening, defect, tilt,
                origin, shared, gradient, solutions,
            )  # fmt: skip
            is_new = False
        if not np.isfinite(cost) or iteration == iterations:
            break
        step = np.zeros(q)
        where = np.flatnonzero(~(((eta <= low) & (gradient < 0.0)) | ((eta >= high) & (gradient > 0.0))))
        if where.size > 0:
            block = np.zeros((where.size, where.size))
            right = np.zeros((where.size, 1))
            scale = np.zeros(where.size)
            for i in range(where.size):
                scale[i] = 1.0 / math.sqrt(max(shared[where[i], where[i]], 1e-300))
            for i in range(where.size):
                right[i, 0] = gradient[where[i]] * scale[i]
                for j in range(where.size):
                    block[i, j] = shared[where[i], where[j]] * scale[i] * scale[j]
                block[i, i] += marquardt + 1e-10
            solve_in_place(block, right)
            for i in range(where.size):
                step[where[i]] = right[i, 0] * scale[i]
        moved = eta.copy()
        for j in range(q):
            if is_log[j] and eta[j] > 0.0:
                moved[j] = eta[j] * math.exp(min(max(step[j] / eta[j], -_LONGEST), _LONGEST))
            elif is_strength[j]:
                moved[j] = eta[j] + step[j]
            else:
                limit = max(_LARGEST_PART * spans[j], 0.1 * widths[j])
                moved[j] = eta[j] + min(max(step[j], -limit), limit)
            moved[j] = min(max(moved[j], low[j]), high[j])
        for i in range(opposed.shape[0]):
            j, other = opposed[i]
            moved[j] = min(max(moved[j], -moved[other]), MOST_OPPOSED * moved[other])
        moved_own = own.copy()
        for r in range(own.shape[0]):
            for i in range(2):
                moved_own[r, i] += solutions[r, i, q]
                for j in range(q):
                    moved_own[r, i] -= solutions[r, i, j] * (moved[j] - eta[j])
            moved_own[r, 1] = max(moved_own[r, 1], 0.0)
        moved_centre = np.zeros(2)
        moved_centre[0], moved_centre[1] = moved_own[:, 0].mean(), moved_own[:, 1].mean()
        _physical(template, free, powers, slips, opposed, amplitude, low, high, moved, vector)
        vector[stiffness], vector[damping] = 0.0, 0.0
        _look_at_all(
            alone, numbers, vector, levels, omegas, is_asymmetric, rounds, points, strengths, moved, moved_centre, eta,
            looks, trials, trial,
        )  # fmt: skip
        spare_shared, spare_gradient, spare = np.zeros((q, q)), np.zeros(q), np.zeros(solutions.shape)
        proposed = np.inf
        if np.isfinite(trial).all():
            proposed, _ = _equations(
                trial, slopes, levels, mass, moved_centre, moved_own, scatter, moved, count, rows, values, whitening,
                defect, tilt, origin, spare_shared, spare_gradient, spare,
            )  # fmt: skip
        if proposed <= cost:
            gain = cost - proposed
            eta[:] = moved
            own[:] = moved_own
            centre[:] = moved_centre
            look[:] = trial
            looks[:] = trials
            is_new = True
            marquardt = max(marquardt / 8.0, 1e-8)
            quiet = quiet + 1 if gain < tolerance * (1.0 + 0.01 * proposed) else 0
            if quiet >= 2 or gain < 0.1 * tolerance:
                iterations = min(iterations, iteration + 1)
        else:
            marquardt *= 6.0
            if marquardt > 1e6:
                break
    return cost, log_determinant
