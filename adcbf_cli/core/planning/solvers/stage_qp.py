"""Compiled: a primal-dual interior-point method for the quadratic programme of `linearise.StageQp`.

Mehrotra's predictor and corrector (Nocedal, Wright: Numerical Optimization, 2nd ed., sec. 16.6). Each
Newton system is one Riccati recursion over the stages, as in Frison's HPIPM: the rows' multipliers and
slacks are eliminated one by one, which leaves a diagonal weight a row.

Soft row: c + g d + give * lam + s - t = 0 with lam t = mu, (cap - lam) s = mu, 0 < lam < cap.
Hard row (limits of the inputs): c + g d - t = 0 with lam t = mu.
With weight = 1 / (give + s / (cap - lam) + t / lam), Newton's step is
    d lam = -weight (g d_new + q),  q = c + give lam + mu / (cap - lam) - mu / lam (and second-order terms),
so a row adds weight g g' to the Hessian and -g (lam - weight q) to the gradient of the programme in d_new.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from adcbf_cli.core.planning.solvers.linearise import FAST, SIDES, StageQp
from adcbf_cli.core.types import FloatArray

TINY = 1e-9
"""Least slack that a hard row starts with, and what keeps Hessians of unweighted inputs regular."""


class Iterate(NamedTuple):
    """Where the method is. lam, t, s: (M, m) soft rows. hard_lam, hard_t: (N, SIDES).
    du: (N, 2), dpose: (N + 1, 3)."""

    lam: FloatArray
    t: FloatArray
    s: FloatArray
    hard_lam: FloatArray
    hard_t: FloatArray
    du: FloatArray
    dpose: FloatArray


class Newton(NamedTuple):
    """One Newton step. weight, q: (M, m), hard_weight, hard_q: (N, SIDES); d_...: steps of the iterate's
    fields; new_du, new_dpose: its target. gain: (N, 2, 5) feedback of du on (d pose, d u[k - 1]),
    inverse: (N, 3) of the 2 x 2 Hessian of du; feed: (N, 2)."""

    weight: FloatArray
    q: FloatArray
    hard_weight: FloatArray
    hard_q: FloatArray
    d_lam: FloatArray
    d_t: FloatArray
    d_s: FloatArray
    d_hard_lam: FloatArray
    d_hard_t: FloatArray
    new_du: FloatArray
    new_dpose: FloatArray
    gain: FloatArray
    inverse: FloatArray
    feed: FloatArray


@njit(cache=True, error_model="numpy", fastmath=FAST)
def empty_iterate(stages: int, row_stages: int, rows: int) -> Iterate:
    return Iterate(
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((stages, SIDES)),
        np.empty((stages, SIDES)),
        np.zeros((stages, 2)),
        np.zeros((stages + 1, 3)),
    )


@njit(cache=True, error_model="numpy", fastmath=FAST)
def empty_newton(stages: int, row_stages: int, rows: int) -> Newton:
    return Newton(
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((stages, SIDES)),
        np.empty((stages, SIDES)),
        np.zeros((row_stages, rows)),
        np.zeros((row_stages, rows)),
        np.zeros((row_stages, rows)),
        np.zeros((stages, SIDES)),
        np.zeros((stages, SIDES)),
        np.empty((stages, 2)),
        np.zeros((stages + 1, 3)),
        np.empty((stages, 2, 5)),
        np.empty((stages, 3)),
        np.empty((stages, 2)),
    )


@njit(cache=True, error_model="numpy", fastmath=FAST)
def solve_qp(qp: StageQp, at: Iterate, newton: Newton, mu_start: float, mu_end: float, max_steps: int) -> int:
    """Solve `qp` from d = 0 and rows on the central path of `mu_start`, to complementarity `mu_end`.

    Leaves the solution in `at`. Returns the number of Newton steps; max_steps + 1 where they did not do.
    """
    _start(qp, at, mu_start)
    pairs = 2 * at.lam.size + 8 * len(at.du) - 4
    left = 1.0
    for step in range(max_steps):
        _weigh(qp, at, newton)
        _factor(qp, newton)
        _solve(qp, at, newton, 0.0, False)
        mu = _complementarity(qp, at, newton, 0.0) / pairs
        length = _longest(qp, at, newton)
        affine = _complementarity(qp, at, newton, length) / pairs
        centring = max((affine / mu) ** 3, 1e-4)
        _solve(qp, at, newton, centring * mu, True)
        length = min(1.0, 0.995 * _longest(qp, at, newton))
        _move(at, newton, length)
        left *= 1.0 - length
        mu = _complementarity(qp, at, newton, 0.0) / pairs
        if not math.isfinite(mu):
            return max_steps + 1
        if mu < mu_end and left < 1e-3:
            return step + 1
    return max_steps + 1


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _start(qp: StageQp, at: Iterate, mu: float) -> None:
    at.du[:] = 0.0
    at.dpose[:] = 0.0
    stages, rows = at.lam.shape
    for k in range(stages):
        for i in range(rows):
            c, cap = qp.value[k, i], qp.cap[k, i]
            root = math.sqrt(c * c * cap * cap + 4.0 * mu * mu)
            less = 2.0 * mu * cap / (abs(c) * cap + 2.0 * mu + root)  # the smaller of lam and cap - lam
            at.lam[k, i] = less if c > 0.0 else cap - less
            at.t[k, i] = mu / at.lam[k, i]
            at.s[k, i] = mu / (cap - less if c > 0.0 else less)
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            t = max(qp.room[k, side], 1e-2)
            at.hard_t[k, side] = t
            at.hard_lam[k, side] = mu / t


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _weigh(qp: StageQp, at: Iterate, newton: Newton) -> None:
    stages, rows = at.lam.shape
    for k in range(stages):
        for i in range(rows):
            lam = at.lam[k, i]
            newton.weight[k, i] = 1.0 / (qp.give[k, i] + at.s[k, i] / (qp.cap[k, i] - lam) + at.t[k, i] / lam)
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            newton.hard_weight[k, side] = at.hard_lam[k, side] / at.hard_t[k, side]


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _factor(qp: StageQp, newton: Newton) -> None:
    """The Riccati recursion's matrices: gain and inverse of every stage."""
    stages = len(qp.ax)
    pxx = pxy = pyy = pxt = pyt = ptt = 0.0  # value function's Hessian at (d pose[k + 1], d u[k])
    px0 = px1 = py0 = py1 = pt0 = pt1 = 0.0
    p00 = p01 = p11 = 0.0
    for k in range(stages - 1, -1, -1):
        nxx = nxy = nyy = fxx = fxy = fyy = cxx = cxy = cyx = cyy = 0.0
        if k < len(newton.weight):
            for i in range(newton.weight.shape[1]):
                w = newton.weight[k, i]
                nx, ny, fx, fy = qp.near_x[k, i], qp.near_y[k, i], qp.far_x[k, i], qp.far_y[k, i]
                nxx += w * nx * nx
                nxy += w * nx * ny
                nyy += w * ny * ny
                fxx += w * fx * fx
                fxy += w * fx * fy
                fyy += w * fy * fy
                cxx += w * fx * nx
                cxy += w * fx * ny
                cyx += w * fy * nx
                cyy += w * fy * ny
        pxx += qp.pose_hess[k, 0] + nxx
        pyy += qp.pose_hess[k, 1] + nyy
        ptt += qp.pose_hess[k, 2]
        pxy += nxy
        ax, ay, b, hard = qp.ax[k], qp.ay[k], qp.b[k], newton.hard_weight[k]
        r0 = qp.change_hess[k, 0]
        r1 = qp.change_hess[k, 1]
        if k > 0:
            r0 += hard[4] + hard[6]
            r1 += hard[5] + hard[7]
        bx0, bx1, by0, by1, bt0, bt1 = b[0, 0], b[0, 1], b[1, 0], b[1, 1], b[2, 0], b[2, 1]
        # P B + P_pu: how the inputs' columns meet the next pose.
        vx0 = pxx * bx0 + pxy * by0 + pxt * bt0 + px0
        vx1 = pxx * bx1 + pxy * by1 + pxt * bt1 + px1
        vy0 = pxy * bx0 + pyy * by0 + pyt * bt0 + py0
        vy1 = pxy * bx1 + pyy * by1 + pyt * bt1 + py1
        vt0 = pxt * bx0 + pyt * by0 + ptt * bt0 + pt0
        vt1 = pxt * bx1 + pyt * by1 + ptt * bt1 + pt1
        h00 = p00 + bx0 * (vx0 + px0) + by0 * (vy0 + py0) + bt0 * (vt0 + pt0)
        h11 = p11 + bx1 * (vx1 + px1) + by1 * (vy1 + py1) + bt1 * (vt1 + pt1)
        h01 = p01 + bx0 * vx1 + by0 * vy1 + bt0 * vt1 + px0 * bx1 + py0 * by1 + pt0 * bt1
        h00 += qp.input_hess[k, 0] + hard[0] + hard[2] + r0 + TINY
        h11 += qp.input_hess[k, 1] + hard[1] + hard[3] + r1 + TINY
        # Inputs against this pose: A' (P B + P_pu), and the rows' own coupling.
        gx0 = vx0 + cxx * bx0 + cxy * by0
        gx1 = vx1 + cxx * bx1 + cxy * by1
        gy0 = vy0 + cyx * bx0 + cyy * by0
        gy1 = vy1 + cyx * bx1 + cyy * by1
        gt0 = vt0 + ax * vx0 + ay * vy0
        gt1 = vt1 + ax * vx1 + ay * vy1
        determinant = h00 * h11 - h01 * h01
        i00, i01, i11 = h11 / determinant, -h01 / determinant, h00 / determinant
        inverse, gain = newton.inverse[k], newton.gain[k]
        inverse[0], inverse[1], inverse[2] = i00, i01, i11
        kx0, kx1 = -(i00 * gx0 + i01 * gx1), -(i01 * gx0 + i11 * gx1)
        ky0, ky1 = -(i00 * gy0 + i01 * gy1), -(i01 * gy0 + i11 * gy1)
        kt0, kt1 = -(i00 * gt0 + i01 * gt1), -(i01 * gt0 + i11 * gt1)
        k00, k10, k01, k11 = i00 * r0, i01 * r0, i01 * r1, i11 * r1
        gain[0, 0], gain[0, 1], gain[0, 2], gain[0, 3], gain[0, 4] = kx0, ky0, kt0, k00, k01
        gain[1, 0], gain[1, 1], gain[1, 2], gain[1, 3], gain[1, 4] = kx1, ky1, kt1, k10, k11
        # The Hessian at (d pose[k], d u[k - 1]): A' P A and the rows, less what the inputs take away.
        ptt += ax * (2.0 * pxt + ax * pxx + ay * pxy) + ay * (2.0 * pyt + ax * pxy + ay * pyy)
        pxt += ax * (pxx + cxx) + ay * (pxy + cxy)
        pyt += ax * (pxy + cyx) + ay * (pyy + cyy)
        pxx += fxx + 2.0 * cxx + gx0 * kx0 + gx1 * kx1
        pxy += fxy + cxy + cyx + gx0 * ky0 + gx1 * ky1
        pyy += fyy + 2.0 * cyy + gy0 * ky0 + gy1 * ky1
        pxt += gx0 * kt0 + gx1 * kt1
        pyt += gy0 * kt0 + gy1 * kt1
        ptt += gt0 * kt0 + gt1 * kt1
        px0, px1 = -r0 * kx0, -r1 * kx1
        py0, py1 = -r0 * ky0, -r1 * ky1
        pt0, pt1 = -r0 * kt0, -r1 * kt1
        p00, p01, p11 = r0 - r0 * k00, -r0 * k01, r1 - r1 * k11


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _solve(qp: StageQp, at: Iterate, newton: Newton, mu: float, second_order: bool) -> None:
    """Newton's step towards complementarity `mu`; `second_order` with the products of the last step."""
    _targets(qp, at, newton, mu, second_order)
    _backward(qp, at, newton)
    _forward(qp, newton)
    _row_steps(qp, at, newton, mu, second_order)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _targets(qp: StageQp, at: Iterate, newton: Newton, mu: float, second_order: bool) -> None:
    stages, rows = at.lam.shape
    keep = 1.0 if second_order else 0.0
    for k in range(stages):
        for i in range(rows):
            lam, d_lam = at.lam[k, i], keep * newton.d_lam[k, i]
            upper = (mu + d_lam * newton.d_s[k, i]) / (qp.cap[k, i] - lam)
            lower = (mu - d_lam * newton.d_t[k, i]) / lam
            newton.q[k, i] = qp.value[k, i] + qp.give[k, i] * lam + upper - lower
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            product = keep * newton.d_hard_lam[k, side] * newton.d_hard_t[k, side]
            newton.hard_q[k, side] = qp.room[k, side] - (mu - product) / at.hard_lam[k, side]


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _backward(qp: StageQp, at: Iterate, newton: Newton) -> None:
    """The Riccati recursion's vectors: feed of every stage."""
    gx = gy = gt = g0 = g1 = 0.0  # value function's gradient at (d pose[k + 1], d u[k])
    for k in range(len(qp.ax) - 1, -1, -1):
        nx = ny = fx = fy = 0.0
        if k < len(at.lam):
            for i in range(at.lam.shape[1]):
                pull = at.lam[k, i] - newton.weight[k, i] * newton.q[k, i]
                nx += pull * qp.near_x[k, i]
                ny += pull * qp.near_y[k, i]
                fx += pull * qp.far_x[k, i]
                fy += pull * qp.far_y[k, i]
        gx += qp.pose_grad[k, 0] - nx
        gy += qp.pose_grad[k, 1] - ny
        gt += qp.pose_grad[k, 2]
        hard = at.hard_lam[k] - newton.hard_weight[k] * newton.hard_q[k]
        change0, change1 = qp.change_grad[k, 0], qp.change_grad[k, 1]
        if k > 0:
            change0 += hard[6] - hard[4]
            change1 += hard[7] - hard[5]
        b, gain, inverse = qp.b[k], newton.gain[k], newton.inverse[k]
        h0 = g0 + b[0, 0] * gx + b[1, 0] * gy + b[2, 0] * gt + qp.input_grad[k, 0] + hard[2] - hard[0] + change0
        h1 = g1 + b[0, 1] * gx + b[1, 1] * gy + b[2, 1] * gt + qp.input_grad[k, 1] + hard[3] - hard[1] + change1
        newton.feed[k, 0] = -(inverse[0] * h0 + inverse[1] * h1)
        newton.feed[k, 1] = -(inverse[1] * h0 + inverse[2] * h1)
        gt += qp.ax[k] * gx + qp.ay[k] * gy + gain[0, 2] * h0 + gain[1, 2] * h1
        gx += -fx + gain[0, 0] * h0 + gain[1, 0] * h1
        gy += -fy + gain[0, 1] * h0 + gain[1, 1] * h1
        g0 = -change0 + gain[0, 3] * h0 + gain[1, 3] * h1
        g1 = -change1 + gain[0, 4] * h0 + gain[1, 4] * h1


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _forward(qp: StageQp, newton: Newton) -> None:
    x = y = yaw = u0 = u1 = 0.0
    for k in range(len(qp.ax)):
        gain, b = newton.gain[k], qp.b[k]
        du0 = newton.feed[k, 0] + gain[0, 0] * x + gain[0, 1] * y + gain[0, 2] * yaw + gain[0, 3] * u0 + gain[0, 4] * u1
        du1 = newton.feed[k, 1] + gain[1, 0] * x + gain[1, 1] * y + gain[1, 2] * yaw + gain[1, 3] * u0 + gain[1, 4] * u1
        x += qp.ax[k] * yaw + b[0, 0] * du0 + b[0, 1] * du1
        y += qp.ay[k] * yaw + b[1, 0] * du0 + b[1, 1] * du1
        yaw += b[2, 0] * du0 + b[2, 1] * du1
        u0, u1 = du0, du1
        newton.new_du[k, 0], newton.new_du[k, 1] = u0, u1
        newton.new_dpose[k + 1, 0], newton.new_dpose[k + 1, 1], newton.new_dpose[k + 1, 2] = x, y, yaw


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _row_steps(qp: StageQp, at: Iterate, newton: Newton, mu: float, second_order: bool) -> None:
    keep = 1.0 if second_order else 0.0
    stages, rows = at.lam.shape
    for k in range(stages):
        near_x, near_y = newton.new_dpose[k + 1, 0], newton.new_dpose[k + 1, 1]
        far_x, far_y = newton.new_dpose[k, 0], newton.new_dpose[k, 1]
        for i in range(rows):
            lam, nu = at.lam[k, i], qp.cap[k, i] - at.lam[k, i]
            upper = mu + keep * newton.d_lam[k, i] * newton.d_s[k, i]
            lower = mu - keep * newton.d_lam[k, i] * newton.d_t[k, i]
            moved = qp.near_x[k, i] * near_x + qp.near_y[k, i] * near_y
            moved += qp.far_x[k, i] * far_x + qp.far_y[k, i] * far_y
            d_lam = -newton.weight[k, i] * (moved + newton.q[k, i])
            newton.d_lam[k, i] = d_lam
            newton.d_t[k, i] = (lower - at.t[k, i] * d_lam) / lam - at.t[k, i]
            newton.d_s[k, i] = (upper + at.s[k, i] * d_lam) / nu - at.s[k, i]
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            j, lam, t = side & 1, at.hard_lam[k, side], at.hard_t[k, side]
            moved = newton.new_du[k, j] - (newton.new_du[k - 1, j] if side >= 4 else 0.0)
            moved = -moved if side & 2 else moved
            lower = mu - keep * newton.d_hard_lam[k, side] * newton.d_hard_t[k, side]
            d_lam = -newton.hard_weight[k, side] * (moved + newton.hard_q[k, side])
            newton.d_hard_lam[k, side] = d_lam
            newton.d_hard_t[k, side] = (lower - t * d_lam) / lam - t


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _complementarity(qp: StageQp, at: Iterate, newton: Newton, length: float) -> float:
    """Sum of the products of slacks and multipliers after a step of that length."""
    total = 0.0
    stages, rows = at.lam.shape
    for k in range(stages):
        for i in range(rows):
            lam = at.lam[k, i] + length * newton.d_lam[k, i]
            total += lam * (at.t[k, i] + length * newton.d_t[k, i])
            total += (qp.cap[k, i] - lam) * (at.s[k, i] + length * newton.d_s[k, i])
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            lam = at.hard_lam[k, side] + length * newton.d_hard_lam[k, side]
            total += lam * (at.hard_t[k, side] + length * newton.d_hard_t[k, side])
    return total


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _longest(qp: StageQp, at: Iterate, newton: Newton) -> float:
    """The longest step, up to a very long one, that keeps slacks and multipliers from being negative."""
    shrink = 1e-3
    stages, rows = at.lam.shape
    for k in range(stages):
        for i in range(rows):
            lam, d_lam = at.lam[k, i], newton.d_lam[k, i]
            shrink = max(shrink, -d_lam / lam, d_lam / (qp.cap[k, i] - lam))
            shrink = max(shrink, -newton.d_t[k, i] / at.t[k, i], -newton.d_s[k, i] / at.s[k, i])
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            shrink = max(shrink, -newton.d_hard_lam[k, side] / at.hard_lam[k, side])
            shrink = max(shrink, -newton.d_hard_t[k, side] / at.hard_t[k, side])
    return min(1.0 / shrink, 1.0)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _move(at: Iterate, newton: Newton, length: float) -> None:
    stages, rows = at.lam.shape
    for k in range(stages):
        for i in range(rows):
            at.lam[k, i] += length * newton.d_lam[k, i]
            at.t[k, i] += length * newton.d_t[k, i]
            at.s[k, i] += length * newton.d_s[k, i]
    for k in range(len(at.du)):
        for side in range(SIDES if k else 4):
            at.hard_lam[k, side] += length * newton.d_hard_lam[k, side]
            at.hard_t[k, side] += length * newton.d_hard_t[k, side]
        for j in range(2):
            at.du[k, j] += length * (newton.new_du[k, j] - at.du[k, j])
        for j in range(3):
            at.dpose[k + 1, j] += length * (newton.new_dpose[k + 1, j] - at.dpose[k + 1, j])
