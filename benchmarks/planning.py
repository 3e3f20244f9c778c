"""How long one planning step takes: every solver on the same instances, the whole planner, a whole replay.

    python benchmarks/planning.py [--instances 100] [--seeds 10] [--json FILE]

Instances are those of a closed loop: the default planner drives through seeded crowds (`crowds.py`) of
standing and walking circles, and asks its solver at each tick. Kept are ticks with exactly n obstacles in
the problem, at least 5 ticks apart, in equal shares of the seeds. Every solver gets the same instance and
the same guess (the planner's first: as a rule its previous plan, shifted), in turn, each in another order
every time.

Times are this process's processor time, one thread: what else the machine does is not in them. Merits are
recomputed from the inputs by one function. The gap is merit / IPOPT's - 1, IPOPT converging from the same
guess. "Better" and "poorer" are the shares of instances in which a solver ended in another local minimum:
lower or higher than IPOPT's by more than 0.1 %.
"""

from __future__ import annotations

import measuring  # isort: skip - it limits the threads before numpy is imported
import argparse
import contextlib
import io
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np
from crowds import PLANNER, Tick, drive

from adcbf_cli.app import app
from adcbf_cli.core.config import Config
from adcbf_cli.core.planning.merit import barrier_rows, merit
from adcbf_cli.core.planning.ocp import Ocp
from adcbf_cli.core.planning.planner import Planner
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.problem import Problem, Solution, SolverStatus
from adcbf_cli.core.planning.solvers.base import Solver, make_solver
from adcbf_cli.core.planning.solvers.ipopt import IpoptSolver
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

OBSTACLES = (5, 10, 20)
CROWDED = 3
"""Circles in the area for each one that the problem shall hold."""

APART = 5
"""Ticks between two instances of a drive, at least."""

BOUND_M2 = 1e-3
"""A barrier row with less than this to spare binds."""

OTHER_MINIMUM = 1e-3
"""A merit that differs from IPOPT's by a larger share belongs to another local minimum."""

SOLVERS: dict[str, tuple[str, int, int]] = {
    "sqp": ("sqp", 5, 10),
    "sqp, one iteration": ("sqp", 1, 1),
    "piqp": ("piqp", 5, 10),
    "ipopt": ("ipopt", 1, 1),
    "ipopt, its default mu_init": ("ipopt", 1, 1),
    "fatrop": ("fatrop", 1, 1),
}
"""By the name of the row: solver, fewest and most iterations (the oracles run until they have converged)."""

ORACLE, PLAIN_ORACLE = "ipopt", "ipopt, its default mu_init"

SAMPLE_PREDICTIONS = ["predict", str(measuring.SAMPLE_LOG), "--range", "12"]

FIRST_SOLVE = """
from time import perf_counter
begin = perf_counter()
import numpy as np
from crowds import drive
from adcbf_cli.core.config import Config
from adcbf_cli.core.planning.solvers.sqp import SqpSolver
loaded = perf_counter()
import crowds
crowds.LONGEST_S = 0.02
drive(0, 10, Config())
print(loaded - begin, perf_counter() - loaded)
"""


class PlainIpopt(IpoptSolver):
    """IPOPT without the package's choice of a first barrier parameter."""

    def options(self, ocp: Ocp) -> dict[str, Any]:
        options = super().options(ocp)
        del options["ipopt"]["mu_init"]
        return options


@dataclass
class Run:
    """What a solver did on each instance."""

    ms: list[float]
    merit: list[float]
    failed: int = 0
    unfinished: int = 0
    """Ended at the limit of iterations."""
    iterations: int = 0

    def add(self, ms: float, solution: Solution, value: float) -> None:
        self.ms.append(ms)
        self.merit.append(value)
        self.failed += solution.status is SolverStatus.FAILED
        self.unfinished += solution.status is SolverStatus.ITERATION_LIMIT
        self.iterations += solution.iterations


def config_for(obstacles: int) -> Config:
    return Config.model_validate({"planning": {"max_obstacles": obstacles}})


def instances(obstacles: int, seeds: int, wanted: int) -> tuple[Problem, list[Tick]]:
    """At most `wanted` ticks with so many obstacles, from as many seeds as have them."""
    share = -(-wanted // seeds)
    found: list[Tick] = []
    problem: Problem | None = None
    for seed in range(seeds):
        problem, ticks = drive(seed, CROWDED * obstacles, config_for(obstacles))
        full = [tick for tick in ticks if len(tick.instance) == obstacles]
        apart = max(APART, len(full) // share)
        found += full[::apart][:share]
    assert problem is not None
    return problem, found[:wanted]


def timed(work: Callable[[], Any]) -> tuple[float, Any]:
    """Milliseconds of this thread's processor time, and what `work` gives."""
    begin = thread_time()
    result = work()
    return 1e3 * (thread_time() - begin), result


def in_lock_step(problem: Problem, ticks: list[Tick]) -> tuple[dict[str, Run], dict[str, float]]:
    """Every solver's run over the instances, and what its first solve took, which builds or loads it."""
    solvers: dict[str, Solver] = {}
    first: dict[str, float] = {}
    for name, (kind, fewest, most) in SOLVERS.items():
        solvers[name] = _built(name, kind, problem, fewest, most)
        first[name], _ = timed(lambda name=name: solvers[name].solve(ticks[0].instance, ticks[0].guess))
    runs = {name: Run([], []) for name in solvers}
    names = list(solvers)
    for number, tick in enumerate(ticks):
        turn = number % len(names)
        for name in names[turn:] + names[:turn]:
            ms, solution = timed(lambda name=name, tick=tick: solvers[name].solve(tick.instance, tick.guess))
            runs[name].add(ms, solution, merit(problem, tick.instance, solution.inputs))
    return runs, first


def _built(name: str, kind: str, problem: Problem, fewest: int, most: int) -> Solver:
    if name == PLAIN_ORACLE:
        return PlainIpopt(problem)
    solver, note = make_solver(kind, problem, fewest, most)
    if note is not None:
        sys.exit(f"benchmarks/planning.py: {note}")
    return solver


def compared(run: Run, oracle: Run) -> dict[str, Any]:
    """A solver's figures beside the oracle's on the same instances."""
    own, best = np.array(run.merit), np.array(oracle.merit)
    gap = own / best - 1.0
    times = measuring.spread(run.ms)
    return {
        "ms": times,
        "ratio": measuring.spread(oracle.ms)["median"] / times["median"],
        "iterations": run.iterations / len(run.ms),
        "failed": run.failed,
        "unfinished": run.unfinished,
        "gap_median": float(np.median(gap)),
        "gap_p95": float(np.quantile(gap, 0.95)),
        "poorer": float((gap > OTHER_MINIMUM).mean()),
        "better": float((gap < -OTHER_MINIMUM).mean()),
        "same_gap_p95": _p95(np.abs(gap[np.abs(gap) <= OTHER_MINIMUM])),
        "mean_merit": float(own.mean()),
    }


def _p95(values: FloatArray) -> float | None:
    return float(np.quantile(values, 0.95)) if len(values) else None


def solver_figures(obstacles: int, seeds: int, wanted: int) -> dict[str, Any]:
    """All solvers with so many obstacles."""
    problem, ticks = instances(obstacles, seeds, wanted)
    binding = [bool((barrier_rows(problem, tick.instance, tick.guess).residual_m2 < BOUND_M2).any()) for tick in ticks]
    runs, first = in_lock_step(problem, ticks)
    return {
        "obstacles": obstacles,
        "instances": len(ticks),
        "binding": float(np.mean(binding)),
        "first_solve_ms": first,
        "solvers": {name: compared(run, runs[ORACLE]) for name, run in runs.items()},
    }


class _Timed:
    """A solver that adds up what it takes."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.ms = 0.0

    def solve(self, instance: Any, guess: FloatArray) -> Solution:
        ms, solution = timed(lambda: self._solver.solve(instance, guess))
        self.ms += ms
        return solution


def planner_figures(seeds: int) -> dict[str, Any]:
    """`MpcPlanner.plan`, with its two starts, and how much of that is its solver's."""
    config = config_for(16)
    whole, solving = [], []
    for seed in range(seeds):
        _, ticks = drive(seed, CROWDED * 10, config)
        planner: Any = make_planner(PLANNER, Vehicle.from_config(config.vehicle), config.planning, Notes())
        planner._solver = clock = _Timed(planner._solver)
        step: Planner = planner
        for tick in ticks:
            clock.ms = 0.0
            ms, _ = timed(lambda step=step, tick=tick: step.plan(tick.situation))
            whole.append(ms)
            solving.append(clock.ms)
    rest = [a - b for a, b in zip(whole, solving, strict=True)]
    return {
        "steps": len(whole),
        "whole": measuring.spread(whole),
        "solver": measuring.spread(solving),
        "rest": measuring.spread(rest),
    }


def first_solves() -> dict[str, float]:
    """Wall seconds to the first plan: in a new installation, which compiles, and in the next process."""
    here = str(Path(__file__).resolve().parent)
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        environment["PYTHONPATH"] = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
        for name in ("compiling", "loading"):
            done = subprocess.run([sys.executable, "-c", FIRST_SOLVE], check=True, capture_output=True, env=environment)
            imports_s, first_s = (float(word) for word in done.stdout.split())
            found[f"{name}_s"] = first_s
            found["imports_s"] = imports_s
    return found


def replay_figures(repeats: int = 3) -> dict[str, float]:
    """`adcbf replay` of the sample log by the default planner, predictions being there: processor seconds of
    the whole command in a process that has run it before, and the seconds that it drives."""
    with tempfile.TemporaryDirectory() as folder:
        run = str(Path(folder, "sample.adcbf"))
        command([*SAMPLE_PREDICTIONS, "-o", run])
        command(["replay", run, "-p", PLANNER])
        spent = [timed(lambda: command(["replay", run, "-p", PLANNER]))[0] / 1e3 for _ in range(repeats)]
        report = json.loads(Path(run, "replay", "report.json").read_text(encoding="utf-8"))
    metrics = report["comparison"]["planners"][PLANNER]["metrics"]
    return {"driven_s": metrics["nav_time_s"]["value"], "replay_s": statistics.median(spent)}


def command(words: list[str]) -> None:
    """Runs `adcbf` in this process, silently."""
    silence = io.StringIO()
    with contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        app(words, standalone_mode=False)


def measure(seeds: int, wanted: int) -> dict[str, Any]:
    return {
        "benchmark": "planning",
        "seeds": seeds,
        "stages": Config().planning.steps,
        "solvers": [solver_figures(obstacles, seeds, wanted) for obstacles in OBSTACLES],
        "planner": planner_figures(min(seeds, 4)),
        "first_solve": first_solves(),
        "replay": replay_figures(),
        "libraries": {name: version(name) for name in ("casadi", "numba", "piqp")},
        "machine": measuring.machine(),
    }


def _percent(value: float) -> str:
    """Two figures; less than a millionth is nothing."""
    if abs(value) < 1e-6:
        return "0"
    return f"{100 * value:.2g}" if abs(value) < 1.0 else f"{100 * value:.0f}"


def solvers_table(found: dict[str, Any]) -> str:
    """One number of obstacles as Markdown."""
    rows = [
        [
            name,
            row["ms"]["median"],
            row["ms"]["p95"],
            row["ms"]["max"],
            row["ratio"],
            row["failed"],
            _percent(row["gap_median"]),
            _percent(row["gap_p95"]),
            _percent(row["better"]),
            _percent(row["poorer"]),
            row["mean_merit"],
        ]
        for name, row in found["solvers"].items()
    ]
    head = ["solver", "p50 ms", "p95 ms", "max ms", "times as fast as IPOPT", "failed"]
    head += ["gap %, median", "p95", "better %", "poorer %", "mean merit"]
    building = ", ".join(f"{name} {found['first_solve_ms'][name]:.0f} ms" for name in ("ipopt", "fatrop"))
    return (
        f"{found['obstacles']} obstacles, {found['instances']} instances; a barrier binds in "
        f"{100 * found['binding']:.0f} % of them. The first solve, which builds the program: {building}.\n\n"
        f"{measuring.markdown(head, rows)}\n"
    )


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    parts = [", ".join(f"{name} {number}" for name, number in result["libraries"].items()) + ".\n"]
    parts += [solvers_table(found) for found in result["solvers"]]
    planner, first, drive = result["planner"], result["first_solve"], result["replay"]
    rows = [[name, *(planner[key][rank] for rank in ("median", "p95", "max"))] for name, key in _PLANNER_ROWS]
    parts.append(f"A whole planning step, {planner['steps']:,} of them:\n")
    parts.append(measuring.markdown(["", "p50 ms", "p95 ms", "max ms"], rows) + "\n")
    parts.append(
        f"To the first plan of a process: {first['compiling_s']:.1f} s where the solver has to be compiled (once an "
        f"installation), {first['loading_s']:.2f} s where it is loaded; its imports before that take "
        f"{first['imports_s']:.2f} s.\n"
    )
    parts.append(
        f"`adcbf replay` of the sample log, {drive['driven_s']:.1f} s at {Config().planning.rate_hz:g} Hz: "
        f"{drive['replay_s']:.2f} s, {drive['driven_s'] / drive['replay_s']:.1f} times as fast as it is driven.\n"
    )
    return "\n".join(parts)


_PLANNER_ROWS = (("`MpcPlanner.plan`, two starts", "whole"), ("the two solves", "solver"), ("the rest", "rest"))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--instances", type=int, default=100, metavar="N", help="of each number of obstacles, at most")
    parser.add_argument("--seeds", type=int, default=10, metavar="N", help="crowds, from seed 0 on")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    measuring.pin_to_one_core()
    result = measure(arguments.seeds, arguments.instances)
    print(table(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
