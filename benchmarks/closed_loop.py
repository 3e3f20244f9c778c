"""How fast a planner is driven through simulated scenes, sensor and all, on one core: by stage, and over all.

    python benchmarks/closed_loop.py [--scene NAME=SEEDS ...] [--ipopt N] [--json FILE]

The loop is that of `adcbf simulate --closed-loop`: ray-cast a scan, cluster, track, predict, plan at 30 Hz.
The same scenes are driven in turn by three of them:

- adcbf: the default planner and what its own sensor sees;
- perfect knowledge: the same planner is told where everything is and will be, so that no scan is taken: what
  is left is the planner and the loop around it;
- IPOPT: as adcbf, but each problem is solved by CasADi's IPOPT until it has converged, as most published
  controllers of this kind do. It takes so long that it drives through the first N scenes only; `adcbf` on
  these alone stands beside it.

A millisecond a simulated second (ms/s) is a thousandth of real time. `rest` is the loop around the stages:
building the scene, moving the vehicle, measuring against the truth. One drive of each kind goes before and is
not counted: it loads, and compiles what is not compiled yet.
"""

from __future__ import annotations

import measuring  # isort: skip - it limits the threads before numpy is imported
import argparse
import sys
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from time import perf_counter_ns
from typing import Any

from adcbf_cli.commands.options import parse_seeds
from adcbf_cli.core.config import CLOSED_LOOP, Config, PlanningConfig
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.replay.sensor_loop import KnowledgeSource, drive_scene
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from adcbf_cli.io.scenarios import read_scenario

PLANNER = "ad-cbf-mpc"
SCENES = ("crossings=100900:100910", "unstructured=100900:100902")
STAGES = ("simulate", "cluster", "track", "predict", "plan")
REST = "rest"
WARM_UP_M = 1.5
"""Length of the drive that warms up."""


@dataclass(frozen=True)
class Loop:
    """A way to drive: what the planner knows, and its solver."""

    name: str
    knowledge: KnowledgeSource
    solver: str

    def config(self) -> Config:
        return CLOSED_LOOP.model_copy(update={"planning": PlanningConfig(solver=self.solver)})


ADCBF = Loop("adcbf", "perception", "sqp")
PERFECT = Loop("perfect knowledge", "perfect", "sqp")
IPOPT = Loop("IPOPT", "perception", "ipopt")


@dataclass(frozen=True)
class Timed:
    """One drive: milliseconds of each call by stage, wall and simulated seconds, how it ended."""

    stage_ms: dict[str, list[float]]
    wall_s: float
    simulated_s: float
    result: str


@dataclass
class Times:
    """Of one loop's drives: milliseconds of each call by stage, wall and simulated seconds of each drive."""

    call_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    wall_s: list[float] = field(default_factory=list)
    simulated_s: list[float] = field(default_factory=list)
    results: Counter[str] = field(default_factory=Counter)

    def add(self, drive: Timed) -> None:
        for stage, values in drive.stage_ms.items():
            self.call_ms[stage] += values
        self.wall_s.append(drive.wall_s)
        self.simulated_s.append(drive.simulated_s)
        self.results[drive.result] += 1

    def summary(self) -> dict[str, Any]:
        simulated_s, wall_s = sum(self.simulated_s), sum(self.wall_s)
        stages: dict[str, Any] = {
            stage: {
                "calls": len(values),
                **{name: value for name, value in measuring.spread(values).items() if name != "max"},
                "ms_per_simulated_s": sum(values) / simulated_s,
            }
            for stage, values in self.call_ms.items()
        }
        rest_ms = 1e3 * wall_s - sum(sum(values) for values in self.call_ms.values())
        stages[REST] = {"calls": len(self.wall_s), "ms_per_simulated_s": rest_ms / simulated_s}
        return {
            "drives": len(self.wall_s),
            "results": dict(self.results),
            "simulated_s": simulated_s,
            "wall_s": wall_s,
            "times_real_time": simulated_s / wall_s,
            "slowest_drive_times_real_time": min(s / w for s, w in zip(self.simulated_s, self.wall_s, strict=True)),
            "stages": stages,
        }


def timed_drive(loop: Loop, text: str, name: str, seed: int) -> Timed:
    """One drive, from the scenario's text to its end."""
    config, notes = loop.config(), Notes()
    planner = make_planner(PLANNER, Vehicle.from_config(config.vehicle), config.planning, notes)
    begin = perf_counter_ns()
    scenario = parse_scenario(text, name, seed)
    ran = drive_scene(scenario, seed, planner, config, notes, perf_counter_ns, loop.knowledge)
    wall_s = (perf_counter_ns() - begin) / 1e9
    drive = ran.drive
    return Timed(ran.stage_ms, wall_s, float(drive.stamp_ns[-1] - drive.stamp_ns[0]) / 1e9, str(drive.result))


def warm_up(loops: Sequence[Loop]) -> None:
    scene = f"""
duration_s: 10
route: {{points_m: [[0, 0], [{WARM_UP_M}, 0]]}}
movers: [{{kind: person, path: {{kind: line, from_m: [1, -3], to_m: [1, 3], speed_mps: 0.5}}}}]
objects: [{{kind: tree, at_m: [1.2, 1.5]}}, {{kind: rock, at_m: [0, -1.5]}}]
lidar: {{kind: spinning, instantaneous: true, azimuth_step_deg: 1}}
"""
    for loop in loops:
        timed_drive(loop, scene, "warm-up", 0)


def measure_scene(spec: str, ipopt: int) -> dict[str, Any]:
    """All loops through the scenes of NAME=SEEDS; `ipopt`: through so many of them IPOPT too."""
    scenario, _, seeds_text = spec.partition("=")
    text, name = read_scenario(scenario)
    seeds = parse_seeds(seeds_text)
    times: dict[str, Times] = defaultdict(Times)
    for number, seed in enumerate(seeds):
        own = timed_drive(ADCBF, text, name, seed)
        times[ADCBF.name].add(own)
        times[PERFECT.name].add(timed_drive(PERFECT, text, name, seed))
        if number < ipopt:
            times[IPOPT.name].add(timed_drive(IPOPT, text, name, seed))
            times[f"{ADCBF.name}, IPOPT's scenes"].add(own)
        print(f"{name}, seed {seed} done", file=sys.stderr)
    return {"scenario": name, "seeds": list(seeds), "loops": {key: found.summary() for key, found in times.items()}}


def measure(scenes: Sequence[str], ipopt: int) -> dict[str, Any]:
    """ipopt: how many scenes of the first kind IPOPT drives through."""
    warm_up([ADCBF, PERFECT, *([IPOPT] if ipopt else [])])
    share = measuring.Share()
    found = [measure_scene(spec, ipopt if number == 0 else 0) for number, spec in enumerate(scenes)]
    return {
        "benchmark": "closed_loop",
        "planner": PLANNER,
        "scenes": found,
        "share_of_core": share(),
        "packages": {name: version(name) for name in ("open3d", "numba", "casadi")},
        "machine": measuring.machine(),
    }


def tables(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    parts = [f"`{result['planner']}`, planning at {CLOSED_LOOP.planning.rate_hz:g} Hz, one core, one thread.\n"]
    rows: list[list[object]] = []
    for found in result["scenes"]:
        for name, loop in found["loops"].items():
            ends = ", ".join(f"{count} {end}" for end, count in sorted(loop["results"].items()))
            row = [found["scenario"], name, ends, loop["simulated_s"], loop["wall_s"]]
            rows.append([*row, loop["times_real_time"], loop["slowest_drive_times_real_time"]])
    head = ["scenario", "loop", "drives", "simulated s", "wall s", "times real time", "slowest drive"]
    parts.append(measuring.markdown(head, rows))
    for found in result["scenes"]:
        parts.append(f"\n{found['scenario']}, by stage: median and 95th percentile of a call in ms, and ms/s:\n")
        parts.append(_by_stage(found["loops"]))
    parts.append(measuring.busy_warning(result["share_of_core"]))
    return "\n".join(parts)


def _by_stage(loops: dict[str, Any]) -> str:
    shown = [name for name in (ADCBF.name, PERFECT.name, IPOPT.name) if name in loops]
    head = ["stage"]
    for name in shown:
        head += [f"{name}: median", "p95", "ms/s"]
    rows: list[list[object]] = []
    for stage in (*STAGES, REST):
        row: list[object] = [stage]
        for name in shown:
            spent = loops[name]["stages"].get(stage, {})
            row += [spent.get("median"), spent.get("p95"), spent.get("ms_per_simulated_s")]
        rows.append(row)
    total: list[object] = ["total"]
    for name in shown:
        total += [None, None, 1e3 / loops[name]["times_real_time"]]
    return measuring.markdown(head, [*rows, total])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scene", action="append", metavar="NAME=SEEDS", help=f"default: {', '.join(SCENES)}")
    parser.add_argument("--ipopt", type=int, default=1, metavar="N", help="scenes that IPOPT drives through too")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    scenes = arguments.scene or list(SCENES)
    if any("=" not in scene for scene in scenes):
        parser.error("--scene takes NAME=SEEDS, such as crossings=100900:100910")
    measuring.pin_to_one_core()
    result = measure(scenes, arguments.ipopt)
    print(tables(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
