"""The MPC planners: one optimal-control problem a tick, from two starts, and the ladder when it fails.

Which planner it is (gamma, decay, held or predicted obstacles) is data, in `presets`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.planning import fallback, pursuit, starts
from adcbf_cli.core.planning.barrier import Barrier, gamma_at
from adcbf_cli.core.planning.columns import Columns, ObstacleSet, can_bind, columns_of, nearest
from adcbf_cli.core.planning.evasion import room_m, roomy_ways
from adcbf_cli.core.planning.merit import barrier_rows, merit, merits, rows_along
from adcbf_cli.core.planning.planner import Details, Outcome, Plan, Situation
from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus, Weights
from adcbf_cli.core.planning.sampled import sampled_starts
from adcbf_cli.core.planning.solvers.base import make_solver
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

STUCK_SHARE = 0.3
"""A plan whose mean speed is below this share of the reference's looks for another way."""

EVADE_GAIN_M = 0.01
"""A way out has to keep this much more room than the solver's plan does."""

FEASIBLE_M2 = 1e-6
"""A smaller barrier violation is the solver's tolerance."""


@dataclass(frozen=True, slots=True)
class _Scene:
    """One tick's problem: what the planner believes, and how much of it the solver sees.

    known: all columns; columns: those in the instance; dropped: how many obstacles `max_obstacles` kept
    out of it. guesses: where to start, by name.
    """

    situation: Situation
    known: Columns
    columns: Columns
    instance: Instance
    dropped: int
    guesses: dict[str, FloatArray]


@dataclass(frozen=True, slots=True)
class _Memory:
    """The plan of an earlier tick."""

    stamp_ns: int
    inputs: FloatArray


class MpcPlanner:
    """See `Planner`. Its next start is its last solution, also where the vehicle braked instead."""

    def __init__(
        self,
        name: str,
        vehicle: Vehicle,
        planning: PlanningConfig,
        barrier: Barrier,
        obstacle_set: ObstacleSet,
        notes: Notes,
    ) -> None:
        self.name = name
        self._planning = planning
        self._obstacle_set = obstacle_set
        self._notes = notes
        self._problem = problem_of(vehicle, planning, barrier)
        self._solver, note = make_solver(
            planning.solver,
            self._problem,
            planning.min_iterations,
            max(planning.min_iterations, planning.max_iterations),
        )
        if note is not None:
            notes.warn(note)
        self._progress = pursuit.Progress()
        self._memory: _Memory | None = None

    def plan(self, situation: Situation) -> Plan:
        scene = self._scene(situation)
        start, solution = self._solve(scene)
        ladder = self._planning.fallback == "ladder"
        if solution is None:
            return self._without_solution(scene) if ladder else self._going_on(scene)
        self._memory = _Memory(situation.stamp_ns, solution.inputs)
        inputs = self._guarded(solution.inputs, situation.inputs)
        poses = self._problem.vehicle.roll_out(situation.pose, inputs, self._problem.step_s)
        details = self._details(scene, start, solution, poses)
        outcome = fallback.outcome_of(details, self._planning.hard and ladder)
        if outcome is Outcome.BRAKED:
            return self._braked(situation, details)
        if ladder and outcome is Outcome.RELAXED:
            return self._evading(scene, poses) or self._relaxed(scene, inputs, poses, details)
        return Plan(outcome, inputs, poses, details)

    def _relaxed(self, scene: _Scene, inputs: FloatArray, poses: FloatArray, details: Details) -> Plan:
        """The plan that violates a barrier, or braking."""
        if self._may_relax(scene, poses):
            return Plan(Outcome.RELAXED, inputs, poses, details)
        return self._braked(scene.situation, details)

    def _evading(self, scene: _Scene, poses: FloatArray) -> Plan | None:
        """Where the plan at these poses comes nearer to what moves than it should: of the last way taken, braking and
        the ways that a search finds the one that keeps the most room, if it keeps EVADE_GAIN_M more; else None."""
        problem, known, situation = self._problem, scene.known, scene.situation
        moving = np.abs(known.centre_m[:, -1] - known.centre_m[:, 0]).max(axis=1, initial=0.0) > 0.0
        if float(room_m(poses[None], known.taken(moving))[0]) >= 0.0:
            return None
        brake = fallback.braking(problem.vehicle, situation, problem.steps, problem.step_s, problem.first_step_s)
        found = roomy_ways(problem, situation.pose, situation.inputs, known, scene.instance.reference)
        ways = [brake.inputs[None], found]
        if "shifted" in scene.guesses:
            ways.insert(0, scene.guesses["shifted"][None])
        inputs = np.concatenate(ways)
        driven, worth = merits(problem, scene.instance, inputs)
        room = room_m(np.concatenate([poses[None], driven]), known)
        most = float(room[1:].max())
        if most < float(room[0]) + EVADE_GAIN_M:
            return None
        roomy = np.flatnonzero(room[1:] >= most - EVADE_GAIN_M / 2)
        best = int(roomy[np.argmin(worth[roomy])])
        self._memory = _Memory(situation.stamp_ns, inputs[best])
        taken = Solution(inputs[best], SolverStatus.FAILED, 0, float(worth[best]))
        details = replace(self._details(scene, "evading", taken, driven[best]), feasible=False)
        return Plan(Outcome.RELAXED, inputs[best], driven[best], details)

    def _scene(self, situation: Situation) -> _Scene:
        problem, planning, pose = self._problem, self._planning, situation.pose
        path, along_m = self._progress.way(situation.path, pose)
        reference = pursuit.horizon(problem.vehicle, path, along_m, pose, problem.steps, problem.step_s)
        followed, aims = starts.follow(problem, path, reference, along_m, pose, situation.inputs)
        keep_m = problem.vehicle.body_radius_m + planning.safety_distance_m
        known = columns_of(situation.obstacles, self._obstacle_set, keep_m, planning.max_margin_m)
        poses = problem.vehicle.roll_out(pose, followed, problem.step_s)
        relevant = known.taken(can_bind(problem, pose, situation.inputs, known))
        columns, dropped = nearest(relevant, poses, planning.max_obstacles)
        guesses = {}
        previous = self._shifted(situation)
        if previous is not None:
            guesses["shifted"] = previous
        if previous is None or planning.starts > 1:
            guesses["reference"] = starts.around(problem, reference, aims, followed, poses, columns, situation.inputs)
        instance = Instance(
            pose=pose,
            last_inputs=situation.inputs,
            reference=reference,
            obstacle_m=columns.centre_m,
            obstacle_radius_m=columns.radius_m,
            keep_out_m=columns.keep_out_m,
            gamma=self._frozen_gamma(columns, pose, next(iter(guesses.values()))),
        )
        return _Scene(situation, known, columns, instance, dropped, guesses)

    def _shifted(self, situation: Situation) -> FloatArray | None:
        if self._memory is None:
            return None
        problem = self._problem
        elapsed_s = (situation.stamp_ns - self._memory.stamp_ns) * 1e-9
        later = starts.shifted(self._memory.inputs, elapsed_s, problem.step_s)
        if later is None:
            return None
        return self._limited(later, situation.inputs)

    def _frozen_gamma(self, columns: Columns, pose: FloatArray, guess: FloatArray) -> FloatArray | None:
        """(n, N) gamma along the first start, where it is not a function inside the problem."""
        barrier = self._problem.barrier
        if not barrier.frozen:
            return None
        poses = self._problem.vehicle.roll_out(pose, guess, self._problem.step_s)
        gap = columns.centre_m[:, :-1] - poses[:-1, :2]
        return gamma_at(barrier.gamma, np.hypot(gap[..., 0], gap[..., 1]), columns.radius_m[:, None])

    def _solve(self, scene: _Scene) -> tuple[str, Solution | None]:
        """The best usable solution of all starts, and which start it came from; None where there is none."""
        best = self._better(scene, ("", None), scene.guesses.items())
        if self._planning.starts > 2 and self._stuck(scene, best[1]):
            sampled = sampled_starts(self._problem, scene.instance, self._planning.starts - 1)
            best = self._better(scene, best, (("sampled", guess) for guess in sampled))
        return best

    def _better(
        self, scene: _Scene, best: tuple[str, Solution | None], guesses: Iterable[tuple[str, FloatArray]]
    ) -> tuple[str, Solution | None]:
        """The best of what there is already and what these guesses lead to."""
        for start, guess in guesses:
            found = self._solver.solve(scene.instance, guess)
            usable = found.status is not SolverStatus.FAILED and bool(np.isfinite(found.inputs).all())
            if usable and np.isfinite(found.merit) and (best[1] is None or found.merit < best[1].merit):
                best = (start, found)
        return best

    def _stuck(self, scene: _Scene, solution: Solution | None) -> bool:
        """Whether there is no plan, or one that violates a barrier, or one that hardly moves where it should."""
        if solution is None:
            return True
        rows = barrier_rows(self._problem, scene.instance, solution.inputs)
        if float(rows.slack_m2.max(initial=0.0)) > FEASIBLE_M2:
            return True
        wanted, planned = float(scene.instance.reference[:, 3].mean()), float(np.abs(solution.inputs[:, 0]).mean())
        return planned < STUCK_SHARE * wanted

    def _guarded(self, inputs: FloatArray, last: FloatArray) -> FloatArray:
        """The solver's inputs within the vehicle's limits: they are already, and it is counted if not."""
        limited = self._limited(inputs, last)
        if np.abs(limited - inputs).max() > 1e-9:
            self._notes.count("plans out of the vehicle's limits")
        return limited

    def _limited(self, inputs: FloatArray, last: FloatArray) -> FloatArray:
        problem = self._problem
        return fallback.within_limits(problem.vehicle, inputs, last, problem.step_s, problem.first_step_s)

    def _details(self, scene: _Scene, start: str, solution: Solution, poses: FloatArray) -> Details:
        rows = rows_along(self._problem, scene.instance, poses)
        violation = float(rows.slack_m2.max(initial=0.0))
        return Details(
            status=solution.status.value,
            start=start,
            iterations=solution.iterations,
            merit=solution.merit,
            violation_m2=violation,
            decay=float(rows.decay.min(initial=1.0)),
            feasible=violation <= FEASIBLE_M2,
            track_id=scene.columns.track_id,
            barrier_m2=rows.barrier_m2,
            gamma=rows.gamma,
            slack_m2=rows.slack_m2,
            dropped=scene.dropped,
        )

    def _may_relax(self, scene: _Scene, poses: FloatArray) -> bool:
        """Whether the planner, by what it believes of the obstacles, may drive on rather than brake."""
        problem, known = self._problem, scene.known
        body_m, safety_m = problem.vehicle.body_radius_m, self._planning.safety_distance_m
        driven = fallback.surface_m(poses, known.centre_m, known.radius_m, body_m)
        driven_m, now_m = float(driven.min(initial=np.inf)), float(driven[:, 0].min(initial=np.inf))
        if driven_m >= safety_m:  # however close braking comes
            return True
        brake = fallback.braking(problem.vehicle, scene.situation, problem.steps, problem.step_s, problem.first_step_s)
        braked = fallback.surface_m(brake.poses, known.centre_m, known.radius_m, body_m)
        return fallback.relaxed_is_better(driven_m, float(braked.min(initial=np.inf)), now_m, safety_m)

    def _without_solution(self, scene: _Scene) -> Plan:
        """Braking, and the next tick starts afresh: a plan that was not renewed is not to be trusted."""
        self._memory = None
        return self._braked(scene.situation, _failed("", scene.dropped))

    def _going_on(self, scene: _Scene) -> Plan:
        """Without the ladder, where no start solved: the last plan goes on; held inputs where there is none.

        RELAXED, with the violation that this leads to, or STOPPED where it stands and goes on standing.
        """
        problem, situation = self._problem, scene.situation
        start, inputs = "shifted", self._shifted(situation)
        if inputs is None:
            start = "held"
            inputs = self._limited(np.tile(situation.inputs, (problem.steps, 1)), situation.inputs)
        worth = merit(problem, scene.instance, inputs)
        unsolved = Solution(inputs, SolverStatus.FAILED, 0, worth)
        poses = problem.vehicle.roll_out(situation.pose, inputs, problem.step_s)
        details = replace(self._details(scene, start, unsolved, poses), feasible=False)
        stands = fallback.stands(situation.inputs) and fallback.stands(inputs[0])
        return Plan(Outcome.STOPPED if stands else Outcome.RELAXED, inputs, poses, details)

    def _braked(self, situation: Situation, details: Details) -> Plan:
        problem = self._problem
        plan = fallback.braking(problem.vehicle, situation, problem.steps, problem.step_s, problem.first_step_s)
        return Plan(plan.outcome, plan.inputs, plan.poses, details)


def problem_of(vehicle: Vehicle, planning: PlanningConfig, barrier: Barrier) -> Problem:
    """The problem that these settings describe."""
    weights = Weights(
        position=planning.weight_position,
        heading=planning.weight_heading,
        speed=planning.weight_speed,
        turn=planning.weight_turn,
        accel=planning.weight_accel,
        turn_accel=planning.weight_turn_accel,
        terminal=planning.weight_terminal,
    )
    return Problem(
        vehicle=vehicle,
        steps=planning.steps,
        step_s=planning.step_s,
        first_step_s=1.0 / planning.rate_hz,
        weights=weights,
        barrier=barrier,
        slack_weight=planning.slack_weight,
    )


def _failed(start: str, dropped: int) -> Details:
    """What is known of a problem that no start solved: nothing but that."""
    nothing = np.empty((0, 0))
    return Details(
        status=SolverStatus.FAILED.value,
        start=start,
        iterations=0,
        merit=np.nan,
        violation_m2=np.nan,
        decay=np.nan,
        feasible=False,
        track_id=np.empty(0, dtype=np.int64),
        barrier_m2=nothing,
        gamma=nothing,
        slack_m2=nothing,
        dropped=dropped,
    )
