"""The optimal-control problem, built once in CasADi from terms that stack, stage by stage.

The model, every cost and every constraint stand here once; IPOPT and FATROP solve what is built, and the
fast solver's own derivatives are held to `stage_functions` by tests.

Multiple shooting. A stage's state is the pose and the last inputs (5); its controls are the inputs (2) and,
where it has barriers, a slack and (optimal decay) a decay for each obstacle slot. Variables stand as x[0],
u[0], x[1], u[1], ..., x[N]; constraints stage by stage, the gap x[k + 1] - F(x[k], u[k]) first in each: the
order that FATROP's Riccati recursion wants. h[k + 1] is written through F, so that every constraint knows
one stage only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from adcbf_cli.core.planning.barrier import AdaptiveGamma
from adcbf_cli.core.planning.merit import barrier_stages
from adcbf_cli.core.planning.problem import Problem
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

STATE = 5
INPUTS = 2

TINY_M2 = 1e-12
"""Under the distance's root, so that its derivative is finite on an obstacle's centre."""


# --- the model ---------------------------------------------------------------------------------------


def next_pose(vehicle: Vehicle, pose: ca.SX, inputs: ca.SX, step_s: float) -> ca.SX:
    """`Vehicle.step` in CasADi: pose (3,) after `step_s`."""
    turn = inputs[1] if vehicle.kind == "unicycle" else inputs[0] * ca.tan(inputs[1]) / vehicle.wheelbase_m
    half = 0.5 * step_s * turn
    chord = inputs[0] * step_s * _sinc(half)
    direction = pose[2] + half
    return ca.vertcat(pose[0] + chord * ca.cos(direction), pose[1] + chord * ca.sin(direction), pose[2] + 2 * half)


def _sinc(angle: ca.SX) -> ca.SX:
    """sin(x) / x, as its series near zero, where the quotient's derivatives would be 0 / 0."""
    near = ca.fabs(angle) < 1e-2
    apart = ca.if_else(near, 1.0, angle)
    square = angle**2
    series = 1 - square / 6 * (1 - square / 20 * (1 - square / 42))
    return ca.if_else(near, series, ca.sin(apart) / apart)


@dataclass(frozen=True, slots=True)
class Slots:
    """The obstacle slots at one time, symbolic columns (n,): centre, R, own radius, frozen gamma."""

    x: ca.SX
    y: ca.SX
    keep_out: ca.SX
    radius: ca.SX
    gamma: ca.SX


def barrier_height(pose: ca.SX, slots: Slots) -> ca.SX:
    """h = |p - o|^2 - R^2 (eq. 13a), (n,)."""
    return (pose[0] - slots.x) ** 2 + (pose[1] - slots.y) ** 2 - slots.keep_out**2


def barrier_floor(problem: Problem, pose: ca.SX, slots: Slots) -> ca.SX:
    """(n,) what the next stage's h must not fall below, without decay."""
    height, gamma = barrier_height(pose, slots), gamma_of(problem, pose, slots)
    return height - gamma if problem.barrier.form == "printed" else (1 - gamma) * height


def gamma_of(problem: Problem, pose: ca.SX, slots: Slots) -> ca.SX:
    """`gamma_at` in CasADi, (n,), or the frozen values where the barrier wants them."""
    gamma = problem.barrier.gamma
    if problem.barrier.frozen:
        return slots.gamma
    if not isinstance(gamma, AdaptiveGamma):
        return ca.SX(gamma.value)
    distance = ca.sqrt((pose[0] - slots.x) ** 2 + (pose[1] - slots.y) ** 2 + TINY_M2)
    far = _edge(distance - gamma.distance_m, gamma.distance_sigma_m, gamma.form)
    large = _edge(slots.radius - gamma.radius_m, gamma.radius_sigma_m, gamma.form)
    value = gamma.amplitude * (1 + far) * (1 - large)
    if gamma.floor is not None:
        value = ca.fmax(value, gamma.floor)
    return value if gamma.ceiling is None else ca.fmin(value, gamma.ceiling)


def _edge(offset: ca.SX, sigma: float, form: str) -> ca.SX:
    root = float(np.sqrt(2.0)) * sigma
    return ca.erf(offset) / root if form == "printed" else ca.erf(offset / root)


# --- terms that stack --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Stage:
    """The symbols of stage k.

    state (5,), inputs (2,), slack and decay (n,) or empty; reached (3,): F(x[k], u[k]). target (5,): the
    reference at k; next_target: at k + 1. slots, next_slots: the obstacles at k and k + 1.
    """

    index: int
    state: ca.SX
    inputs: ca.SX
    slack: ca.SX
    decay: ca.SX
    reached: ca.SX
    target: ca.SX
    next_target: ca.SX
    slots: Slots
    next_slots: Slots


@dataclass(frozen=True, slots=True)
class Rows:
    """A stage's constraint rows: lower <= value <= upper, where the bounds are constants."""

    value: ca.SX
    lower: FloatArray
    upper: FloatArray


CostTerm = Callable[[Problem, Stage], ca.SX]
ConstraintTerm = Callable[[Problem, Stage], Rows]


def pose_cost(problem: Problem, state: ca.SX, target: ca.SX) -> ca.SX:
    """Position and heading against the reference."""
    off = state[:3] - target[:3]
    return 0.5 * (problem.weights.position * ca.sumsqr(off[:2]) + problem.weights.heading * off[2] ** 2)


def tracking(problem: Problem, stage: Stage) -> ca.SX:
    return pose_cost(problem, stage.state, stage.target) if stage.index else ca.SX(0)


def speed(problem: Problem, stage: Stage) -> ca.SX:
    return 0.5 * problem.weights.speed * (stage.inputs[0] - stage.next_target[3]) ** 2


def turn(problem: Problem, stage: Stage) -> ca.SX:
    return 0.5 * problem.weights.turn * (stage.inputs[1] - stage.next_target[4]) ** 2


def smoothness(problem: Problem, stage: Stage) -> ca.SX:
    rate = (stage.inputs - stage.state[3:]) / (problem.step_s if stage.index else problem.first_step_s)
    return 0.5 * (problem.weights.accel * rate[0] ** 2 + problem.weights.turn_accel * rate[1] ** 2)


def slack(problem: Problem, stage: Stage) -> ca.SX:
    return problem.slack_weight * ca.sum1(stage.slack)


def decay(problem: Problem, stage: Stage) -> ca.SX:
    weight = problem.barrier.decay_weight
    return ca.SX(0) if weight is None else weight * ca.sumsqr(stage.decay - 1)


def rates(problem: Problem, stage: Stage) -> Rows:
    """Limits on the change of inputs; the first stage's are in its box, as the last inputs are known."""
    if not stage.index:
        return Rows(ca.SX(0, 1), np.zeros(0), np.zeros(0))
    reach = problem.vehicle.rate_max * problem.step_s
    return Rows(stage.inputs - stage.state[3:], -reach, reach)


def barriers(problem: Problem, stage: Stage) -> Rows:
    """h[k + 1] + slack >= decay * floor, one row a slot."""
    count = stage.slack.numel()
    if not count:
        return Rows(ca.SX(0, 1), np.zeros(0), np.zeros(0))
    floor = barrier_floor(problem, stage.state, stage.slots)
    if not stage.decay.is_empty():
        floor = stage.decay * floor
    value = barrier_height(stage.reached, stage.next_slots) - floor + stage.slack
    return Rows(value, np.zeros(count), np.full(count, np.inf))


COSTS: tuple[CostTerm, ...] = (tracking, speed, turn, smoothness, slack, decay)
CONSTRAINTS: tuple[ConstraintTerm, ...] = (rates, barriers)
"""`barriers` last: the rows of unused slots, which an instance loosens, are then a stage's last."""


# --- the problem -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Ocp:
    """A nonlinear program for up to `slots` obstacles; `solvers.program` brings instances into it.

    nlp: x, f, g, p for casadi.nlpsol. p is the pose and last inputs, then, stage after stage, the
    reference, the slots' x, their y, their R, and their own radius and, where the barrier is frozen, gamma.
    lower, upper: of g, all slots in use. equality: a row of g each. states, controls, rows: per stage
    k = 0..N, how many of each (rows without the gap).
    """

    problem: Problem
    slots: int
    nlp: dict[str, ca.SX]
    lower: FloatArray
    upper: FloatArray
    equality: list[bool]
    states: list[int]
    controls: list[int]
    rows: list[int]


def build(problem: Problem, slots: int) -> Ocp:
    """The program of `problem` with room for `slots` obstacles."""
    symbols = _Parameters.of(problem, slots)
    variables: list[ca.SX] = []
    stages: list[Stage] = []
    for k in range(problem.steps):
        stage = _stage(problem, symbols, k)
        stages.append(stage)
        variables += [stage.state, stage.inputs, stage.slack, stage.decay]
    last = ca.SX.sym("last_state", STATE)
    targets = symbols.reference
    cost = ca.SX(problem.weights.terminal) * pose_cost(problem, last, targets[:, problem.steps])
    groups: list[list[Rows]] = []
    for stage, following in zip(stages, [*(s.state for s in stages[1:]), last], strict=True):
        cost = sum((term(problem, stage) for term in COSTS), start=cost)
        gap = following - ca.vertcat(stage.reached, stage.inputs)
        fixed = [_equal(stage.state - symbols.start)] if not stage.index else []
        groups.append([_equal(gap), *fixed, *(term(problem, stage) for term in CONSTRAINTS)])
    rows = [row for group in groups for row in group]
    lower, upper = (np.concatenate([getattr(row, end) for row in rows]) for end in ("lower", "upper"))
    return Ocp(
        problem=problem,
        slots=slots,
        nlp={
            "x": ca.vertcat(*variables, last),
            "f": cost,
            "g": ca.vertcat(*(row.value for row in rows)),
            "p": symbols.stacked(),
        },
        lower=lower,
        upper=upper,
        equality=[bool(same) for same in lower == upper],
        states=[STATE] * (problem.steps + 1),
        controls=[INPUTS + stage.slack.numel() + stage.decay.numel() for stage in stages] + [0],
        rows=[sum(row.value.numel() for row in group[1:]) for group in groups] + [0],
    )


@dataclass(frozen=True, slots=True)
class _Parameters:
    """What an instance gives, symbolic; columns are stages."""

    start: ca.SX
    reference: ca.SX
    x: ca.SX
    y: ca.SX
    keep_out: ca.SX
    radius: ca.SX
    gamma: ca.SX

    @staticmethod
    def of(problem: Problem, slots: int) -> _Parameters:
        stages = problem.steps + 1
        return _Parameters(
            start=ca.SX.sym("start", STATE),
            reference=ca.SX.sym("reference", 5, stages),
            x=ca.SX.sym("obstacle_x", slots, stages),
            y=ca.SX.sym("obstacle_y", slots, stages),
            keep_out=ca.SX.sym("keep_out", slots, stages),
            radius=ca.SX.sym("radius", slots),
            gamma=ca.SX.sym("gamma", slots, problem.steps) if problem.barrier.frozen else ca.SX(slots, 0),
        )

    def slots(self, k: int) -> Slots:
        gamma = self.gamma[:, k] if k < self.gamma.shape[1] else ca.SX(self.radius.numel(), 1)
        return Slots(self.x[:, k], self.y[:, k], self.keep_out[:, k], self.radius, gamma)

    def stacked(self) -> ca.SX:
        parts = (self.start, self.reference, self.x, self.y, self.keep_out, self.radius, self.gamma)
        return ca.vertcat(*(ca.vec(part) for part in parts))


def _stage(problem: Problem, symbols: _Parameters, k: int) -> Stage:
    count = symbols.radius.numel() if k < barrier_stages(problem) else 0
    state, inputs = ca.SX.sym(f"x{k}", STATE), ca.SX.sym(f"u{k}", INPUTS)
    return Stage(
        index=k,
        state=state,
        inputs=inputs,
        slack=ca.SX.sym(f"slack{k}", count),
        decay=ca.SX.sym(f"decay{k}", 0 if problem.barrier.decay_weight is None else count),
        reached=next_pose(problem.vehicle, state, inputs, problem.step_s),
        target=symbols.reference[:, k],
        next_target=symbols.reference[:, k + 1],
        slots=symbols.slots(k),
        next_slots=symbols.slots(k + 1),
    )


def _equal(value: ca.SX) -> Rows:
    return Rows(value, np.zeros(value.numel()), np.zeros(value.numel()))


# --- for tests of other derivatives ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class StageFunctions:
    """The model of one stage and one obstacle, with its derivatives, as casadi.Function.

    step(pose, inputs) -> next pose (3,), by pose (3, 3), by inputs (3, 2).
    row(pose, inputs, obstacle (2,), next obstacle (2,), R, next R, own radius, frozen gamma) -> residual
        h[k + 1] - floor with w = 1, by pose (1, 3), by inputs (1, 2). The gamma given counts only where
        the barrier is frozen.
    """

    step: ca.Function
    row: ca.Function


def stage_functions(problem: Problem) -> StageFunctions:
    """The derivatives that a hand-written kernel is held to."""
    pose, inputs = ca.SX.sym("pose", 3), ca.SX.sym("inputs", INPUTS)
    reached = next_pose(problem.vehicle, pose, inputs, problem.step_s)
    step = [reached, ca.jacobian(reached, pose), ca.jacobian(reached, inputs)]
    here, there = ca.SX.sym("obstacle", 2), ca.SX.sym("next_obstacle", 2)
    keep_out, next_keep_out = ca.SX.sym("keep_out"), ca.SX.sym("next_keep_out")
    radius, gamma = ca.SX.sym("radius"), ca.SX.sym("gamma")
    slots = Slots(here[0], here[1], keep_out, radius, gamma)
    next_slots = Slots(there[0], there[1], next_keep_out, radius, gamma)
    residual = barrier_height(reached, next_slots) - barrier_floor(problem, pose, slots)
    row = [residual, ca.jacobian(residual, pose), ca.jacobian(residual, inputs)]
    given = [pose, inputs, here, there, keep_out, next_keep_out, radius, gamma]
    return StageFunctions(ca.Function("step", [pose, inputs], step), ca.Function("row", given, row))
