"""Compiled: a primal-dual interior-point method for the quadratic programme of a `packing.StageQp`.

Mehrotra's predictor and corrector (Nocedal, Wright: Numerical Optimization, 2nd ed., sec. 16.6). Each
Newton system is one Riccati recursion over the stages (Rao, Wright, Rawlings 1998): the rows'
multipliers and slacks are eliminated one by one, which leaves a weight a row.

Soft row: c + g d + give lam + s - t = 0 with lam t = mu, (cap - lam) s = mu, 0 < lam < cap.
Hard row (limits of the inputs): c + g d + HARD_GIVE lam - t = 0 with lam t = mu. The give is there for
limits that leave a single value, which have no inside.
With weight = 1 / (give + s / (cap - lam) + t / lam), Newton's step is
    d lam = -weight (g d_new + q),  q = c + give lam + mu / (cap - lam) - mu / lam (and second-order terms),
so a row adds weight g g' to the Hessian and -g (lam - weight q) to the gradient of the programme in d_new.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adcbf_cli.core.planning.solvers.compiling import ENDLESS, compiled
from adcbf_cli.core.planning.solvers.packing import (
    CAP,
    FAR_X,
    FAR_Y,
    GIVE,
    NEAR_X,
    NEAR_Y,
    SIDES,
    VALUE,
    StageQp,
)
from adcbf_cli.core.types import FloatArray

LAM, T, S, D_LAM, D_T, D_S, WEIGHT, Q, PER_LAM, PER_NU = range(10)
"""Where the method keeps what of its rows; the last two are 1 / lam and 1 / (cap - lam)."""

HARD_GIVE = 1e-8
"""How far hard rows give, m/s or rad/s per unit of their multipliers."""

LEAST_ROOM = 1e-2
"""Least slack that a hard row starts with, m/s or rad/s."""

REGULAR = 1e-9
"""Added to the Hessian of the inputs, which may be without weights."""


class Iterate(NamedTuple):
    """Where the method is, and its last Newton step.

    soft: (M, 10, m) and hard: (N, 10, SIDES), by LAM and so on. step: (N, 5) du and d pose[k + 1];
    target: (N, 5) where Newton's step leads. gain: (N, 10) feedback of either input on (d pose[k],
    d u[k - 1]). feed: (N, 5): the rest of it, and the inverse of the 2 x 2 Hessian of du.
    """

    soft: FloatArray
    hard: FloatArray
    step: FloatArray
    target: FloatArray
    gain: FloatArray
    feed: FloatArray


@compiled
def solve_qp(qp: StageQp, mu_start: float, mu_end: float, max_steps: int) -> tuple[FloatArray, int]:
    """Solve `qp` from d = 0 and rows on the central path of `mu_start`, to complementarity `mu_end`.

    Returns the step (N, 5) of inputs and poses, and the number of Newton steps.
    """
    at = _start(qp, mu_start)
    pairs = 2 * len(qp.rows) * qp.rows.shape[2] + SIDES * len(qp.room) - 4
    left, taken = 1.0, 0
    for _ in range(max_steps):
        total = _weigh(qp, at)
        _factor(qp, at)
        affine, cross = _newton(qp, at, 0.0)
        affine = min(affine, 1.0)
        share = ((1.0 - affine) * total + affine * affine * cross) / total
        mu = max(share * share * share, 1e-4) * total / pairs
        _targets(qp, at, mu)
        length, new_cross = _newton(qp, at, mu)
        length = min(0.995 * length, 1.0)
        total += length * (mu * pairs - cross - total) + length * length * new_cross
        if not abs(total) < ENDLESS:
            break
        _move(at, length)
        taken += 1
        left *= 1.0 - length
        if total < mu_end * pairs and left < 1e-3:
            break
    return at.step, taken


@compiled
def _start(qp: StageQp, mu: float) -> Iterate:
    stages, _, rows = qp.rows.shape
    steps = len(qp.room)
    at = Iterate(
        np.zeros((stages, 10, rows)),
        np.zeros((steps, 10, SIDES)),
        np.zeros((steps, 5)),
        np.zeros((steps, 5)),
        np.empty((steps, 10)),
        np.empty((steps, 5)),
    )
    for k in range(stages):
        for i in range(rows):
            cap = qp.rows[k, CAP, i]
            pull = qp.rows[k, VALUE, i] * cap
            root = math.sqrt(pull * pull + 4.0 * mu * mu)
            less = 2.0 * mu * cap / (abs(pull) + 2.0 * mu + root)  # the smaller of lam and cap - lam
            more = cap - less
            lam, nu = (less, more) if pull > 0.0 else (more, less)
            at.soft[k, LAM, i], at.soft[k, T, i], at.soft[k, S, i] = lam, mu / lam, mu / nu
    at.hard[:, T] = 1.0
    for k in range(steps):
        for side in range(SIDES if k else 4):
            at.hard[k, T, side] = max(qp.room[k, side], LEAST_ROOM)
            at.hard[k, LAM, side] = mu / at.hard[k, T, side]
    return at


@compiled
def _weigh(qp: StageQp, at: Iterate) -> float:
    """Fill weights, reciprocals and the predictor's q; returns the sum of all products lam t and nu s."""
    total = 0.0
    for k in range(len(at.soft)):
        lam, t, s, weight = at.soft[k, LAM], at.soft[k, T], at.soft[k, S], at.soft[k, WEIGHT]
        per_lam, per_nu, q = at.soft[k, PER_LAM], at.soft[k, PER_NU], at.soft[k, Q]
        value, cap, give = qp.rows[k, VALUE], qp.rows[k, CAP], qp.rows[k, GIVE]
        for i in range(len(lam)):
            nu = cap[i] - lam[i]
            total += lam[i] * t[i] + nu * s[i]
            per_lam[i] = 1.0 / lam[i]
            per_nu[i] = 1.0 / nu
            weight[i] = 1.0 / (give[i] + s[i] * per_nu[i] + t[i] * per_lam[i])
            q[i] = value[i] + give[i] * lam[i]
    for k in range(len(qp.room)):
        lam, t, weight = at.hard[k, LAM], at.hard[k, T], at.hard[k, WEIGHT]
        per_lam, q = at.hard[k, PER_LAM], at.hard[k, Q]
        for side in range(SIDES if k else 4):
            total += lam[side] * t[side]
            per_lam[side] = 1.0 / lam[side]
            weight[side] = 1.0 / (HARD_GIVE + t[side] * per_lam[side])
            q[side] = qp.room[k, side] + HARD_GIVE * lam[side]
    return total


@compiled
def _targets(qp: StageQp, at: Iterate, mu: float) -> None:
    """Fill the corrector's q, with the products of the predictor's step."""
    for k in range(len(at.soft)):
        lam, d_lam, d_t, d_s = at.soft[k, LAM], at.soft[k, D_LAM], at.soft[k, D_T], at.soft[k, D_S]
        per_lam, per_nu, q = at.soft[k, PER_LAM], at.soft[k, PER_NU], at.soft[k, Q]
        value, give = qp.rows[k, VALUE], qp.rows[k, GIVE]
        for i in range(len(lam)):
            upper, lower = (mu + d_lam[i] * d_s[i]) * per_nu[i], (mu - d_lam[i] * d_t[i]) * per_lam[i]
            q[i] = value[i] + give[i] * lam[i] + upper - lower
    for k in range(len(qp.room)):
        for side in range(SIDES if k else 4):
            lower = mu - at.hard[k, D_LAM, side] * at.hard[k, D_T, side]
            give = HARD_GIVE * at.hard[k, LAM, side]
            at.hard[k, Q, side] = qp.room[k, side] + give - lower * at.hard[k, PER_LAM, side]


@compiled
def _squares(
    qp: StageQp, at: Iterate, k: int
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """What stage k's rows add to the Hessian: xx, xy, yy of d xy[k + 1], of d xy[k], and d xy[k] d xy[k + 1]'."""
    nxx = nxy = nyy = fxx = fxy = fyy = cxx = cxy = cyx = cyy = 0.0
    if k < len(at.soft):
        weight = at.soft[k, WEIGHT]
        near_x, near_y, far_x, far_y = qp.rows[k, NEAR_X], qp.rows[k, NEAR_Y], qp.rows[k, FAR_X], qp.rows[k, FAR_Y]
        for i in range(len(weight)):
            nx, ny = weight[i] * near_x[i], weight[i] * near_y[i]
            fx, fy = weight[i] * far_x[i], weight[i] * far_y[i]
            nxx += nx * near_x[i]
            nxy += nx * near_y[i]
            nyy += ny * near_y[i]
            fxx += fx * far_x[i]
            fxy += fx * far_y[i]
            fyy += fy * far_y[i]
            cxx += fx * near_x[i]
            cxy += fx * near_y[i]
            cyx += fy * near_x[i]
            cyy += fy * near_y[i]
    return nxx, nxy, nyy, fxx, fxy, fyy, cxx, cxy, cyx, cyy


@compiled
def _factor(qp: StageQp, at: Iterate) -> None:
    """The Riccati recursion's matrices: gain and inverse of every stage.

    p..: the value function's Hessian at (d pose[k + 1], d u[k]); v..: that of the next pose against the
    inputs; h..: that of the inputs; g..: that of this pose against the inputs.
    """
    pxx = pxy = pyy = pxt = pyt = ptt = px0 = px1 = py0 = py1 = pt0 = pt1 = p00 = p01 = p11 = 0.0
    for k in range(len(qp.room) - 1, -1, -1):
        nxx, nxy, nyy, fxx, fxy, fyy, cxx, cxy, cyx, cyy = _squares(qp, at, k)
        pxx += qp.pose[k, 3] + nxx
        pxy += nxy
        pyy += qp.pose[k, 4] + nyy
        ptt += qp.pose[k, 5]
        hard, cost, feed, gain = at.hard[k, WEIGHT], qp.inputs[k], at.feed[k], at.gain[k]
        r0, r1 = cost[6] + hard[4] + hard[6], cost[7] + hard[5] + hard[7]
        ax, ay, bx0, bx1, by0, by1, bt0, bt1 = qp.motion[k]
        vx0 = pxx * bx0 + pxy * by0 + pxt * bt0 + px0
        vx1 = pxx * bx1 + pxy * by1 + pxt * bt1 + px1
        vy0 = pxy * bx0 + pyy * by0 + pyt * bt0 + py0
        vy1 = pxy * bx1 + pyy * by1 + pyt * bt1 + py1
        vt0 = pxt * bx0 + pyt * by0 + ptt * bt0 + pt0
        vt1 = pxt * bx1 + pyt * by1 + ptt * bt1 + pt1
        h00 = p00 + bx0 * (vx0 + px0) + by0 * (vy0 + py0) + bt0 * (vt0 + pt0) + r0
        h11 = p11 + bx1 * (vx1 + px1) + by1 * (vy1 + py1) + bt1 * (vt1 + pt1) + r1
        h01 = p01 + bx0 * vx1 + by0 * vy1 + bt0 * vt1 + px0 * bx1 + py0 * by1 + pt0 * bt1
        h00 += cost[2] + hard[0] + hard[2] + REGULAR
        h11 += cost[3] + hard[1] + hard[3] + REGULAR
        gx0, gx1 = vx0 + cxx * bx0 + cxy * by0, vx1 + cxx * bx1 + cxy * by1
        gy0, gy1 = vy0 + cyx * bx0 + cyy * by0, vy1 + cyx * bx1 + cyy * by1
        gt0, gt1 = vt0 + ax * vx0 + ay * vy0, vt1 + ax * vx1 + ay * vy1
        determinant = h00 * h11 - h01 * h01
        i00, i01, i11 = h11 / determinant, -h01 / determinant, h00 / determinant
        kx0, kx1 = -(i00 * gx0 + i01 * gx1), -(i01 * gx0 + i11 * gx1)
        ky0, ky1 = -(i00 * gy0 + i01 * gy1), -(i01 * gy0 + i11 * gy1)
        kt0, kt1 = -(i00 * gt0 + i01 * gt1), -(i01 * gt0 + i11 * gt1)
        feed[2], feed[3], feed[4] = i00, i01, i11
        gain[0], gain[1], gain[2], gain[3], gain[4] = kx0, ky0, kt0, i00 * r0, i01 * r1
        gain[5], gain[6], gain[7], gain[8], gain[9] = kx1, ky1, kt1, i01 * r0, i11 * r1
        ptt += ax * (2.0 * pxt + ax * pxx + ay * pxy) + ay * (2.0 * pyt + ax * pxy + ay * pyy)
        ptt += gt0 * kt0 + gt1 * kt1
        pxt += ax * (pxx + cxx) + ay * (pxy + cxy) + gx0 * kt0 + gx1 * kt1
        pyt += ax * (pxy + cyx) + ay * (pyy + cyy) + gy0 * kt0 + gy1 * kt1
        pxx += fxx + 2.0 * cxx + gx0 * kx0 + gx1 * kx1
        pxy += fxy + cxy + cyx + gx0 * ky0 + gx1 * ky1
        pyy += fyy + 2.0 * cyy + gy0 * ky0 + gy1 * ky1
        px0, px1, py0, py1, pt0, pt1 = -r0 * kx0, -r1 * kx1, -r0 * ky0, -r1 * ky1, -r0 * kt0, -r1 * kt1
        p00, p01, p11 = r0 - r0 * i00 * r0, -r0 * i01 * r1, r1 - r1 * i11 * r1


@compiled
def _newton(qp: StageQp, at: Iterate, mu: float) -> tuple[float, float]:
    """Newton's step towards complementarity `mu`, with second-order terms of the last one where mu > 0.

    Returns how much of it keeps all slacks and multipliers from being negative, at most 1000, and the
    sum of d lam d t and d nu d s.
    """
    _backward(qp, at)
    _forward(qp, at)
    return _row_steps(qp, at, mu)


@compiled
def _backward(qp: StageQp, at: Iterate) -> None:
    """The Riccati recursion's vectors: feed of every stage."""
    gx = gy = gt = g0 = g1 = 0.0  # value function's gradient at (d pose[k + 1], d u[k])
    for k in range(len(qp.room) - 1, -1, -1):
        nx = ny = fx = fy = 0.0
        if k < len(at.soft):
            lam, weight, q = at.soft[k, LAM], at.soft[k, WEIGHT], at.soft[k, Q]
            near_x, near_y = qp.rows[k, NEAR_X], qp.rows[k, NEAR_Y]
            far_x, far_y = qp.rows[k, FAR_X], qp.rows[k, FAR_Y]
            for i in range(len(lam)):
                pull = lam[i] - weight[i] * q[i]
                nx += pull * near_x[i]
                ny += pull * near_y[i]
                fx += pull * far_x[i]
                fy += pull * far_y[i]
        gx += qp.pose[k, 0] - nx
        gy += qp.pose[k, 1] - ny
        gt += qp.pose[k, 2]
        push, cost, gain, feed = at.hard[k, S], qp.inputs[k], at.gain[k], at.feed[k]
        for side in range(SIDES):
            push[side] = at.hard[k, LAM, side] - at.hard[k, WEIGHT, side] * at.hard[k, Q, side]
        change0, change1 = cost[4] + push[6] - push[4], cost[5] + push[7] - push[5]
        ax, ay, bx0, bx1, by0, by1, bt0, bt1 = qp.motion[k]
        h0 = g0 + bx0 * gx + by0 * gy + bt0 * gt + cost[0] + push[2] - push[0] + change0
        h1 = g1 + bx1 * gx + by1 * gy + bt1 * gt + cost[1] + push[3] - push[1] + change1
        feed[0] = -(feed[2] * h0 + feed[3] * h1)
        feed[1] = -(feed[3] * h0 + feed[4] * h1)
        gt += ax * gx + ay * gy + gain[2] * h0 + gain[7] * h1
        gx += gain[0] * h0 + gain[5] * h1 - fx
        gy += gain[1] * h0 + gain[6] * h1 - fy
        g0 = gain[3] * h0 + gain[8] * h1 - change0
        g1 = gain[4] * h0 + gain[9] * h1 - change1


@compiled
def _forward(qp: StageQp, at: Iterate) -> None:
    x = y = yaw = u0 = u1 = 0.0
    for k in range(len(qp.room)):
        gain, feed, target = at.gain[k], at.feed[k], at.target[k]
        ax, ay, bx0, bx1, by0, by1, bt0, bt1 = qp.motion[k]
        d0 = feed[0] + gain[0] * x + gain[1] * y + gain[2] * yaw + gain[3] * u0 + gain[4] * u1
        d1 = feed[1] + gain[5] * x + gain[6] * y + gain[7] * yaw + gain[8] * u0 + gain[9] * u1
        u0, u1 = d0, d1
        x += ax * yaw + bx0 * u0 + bx1 * u1
        y += ay * yaw + by0 * u0 + by1 * u1
        yaw += bt0 * u0 + bt1 * u1
        target[0], target[1], target[2], target[3], target[4] = u0, u1, x, y, yaw


@compiled
def _row_steps(qp: StageQp, at: Iterate, mu: float) -> tuple[float, float]:
    keep = 1.0 if mu > 0.0 else 0.0
    shrink, cross = 1e-3, 0.0
    x = y = 0.0
    for k in range(len(at.soft)):
        lam, t, s, d_lam, d_t, d_s, weight, q, per_lam, per_nu = at.soft[k]
        near_x, near_y, far_x, far_y = qp.rows[k, NEAR_X], qp.rows[k, NEAR_Y], qp.rows[k, FAR_X], qp.rows[k, FAR_Y]
        next_x, next_y = at.target[k, 2], at.target[k, 3]
        for i in range(len(lam)):
            upper, lower = mu + keep * d_lam[i] * d_s[i], mu - keep * d_lam[i] * d_t[i]
            moved = near_x[i] * next_x + near_y[i] * next_y + far_x[i] * x + far_y[i] * y
            change = -weight[i] * (moved + q[i])
            d_lam[i] = change
            d_t[i] = (lower - t[i] * change) * per_lam[i] - t[i]
            d_s[i] = (upper + s[i] * change) * per_nu[i] - s[i]
            cross += change * (d_t[i] - d_s[i])
            shrink = max(shrink, -change * per_lam[i], change * per_nu[i], -d_t[i] / t[i], -d_s[i] / s[i])
        x, y = next_x, next_y
    for k in range(len(qp.room)):
        for side in range(SIDES if k else 4):
            lam, t = at.hard[k, LAM, side], at.hard[k, T, side]
            moved = at.target[k, side & 1] - (at.target[k - 1, side & 1] if side >= 4 else 0.0)
            moved = -moved if side & 2 else moved
            lower = mu - keep * at.hard[k, D_LAM, side] * at.hard[k, D_T, side]
            change = -at.hard[k, WEIGHT, side] * (moved + at.hard[k, Q, side])
            widen = (lower - t * change) * at.hard[k, PER_LAM, side] - t
            at.hard[k, D_LAM, side], at.hard[k, D_T, side] = change, widen
            cross += change * widen
            shrink = max(shrink, -change * at.hard[k, PER_LAM, side], -widen / t)
    return 1.0 / shrink, cross


@compiled
def _move(at: Iterate, length: float) -> None:
    for k in range(len(at.soft)):
        for part in range(3):
            for i in range(at.soft.shape[2]):
                at.soft[k, part, i] += length * at.soft[k, D_LAM + part, i]
    for k in range(len(at.hard)):
        for part in range(2):
            for side in range(SIDES):
                at.hard[k, part, side] += length * at.hard[k, D_LAM + part, side]
    for k in range(len(at.step)):
        for j in range(5):
            at.step[k, j] += length * (at.target[k, j] - at.step[k, j])
