"""The options that several commands share, declared once.

`@shared_options` gives a command function that takes a `Shared` (and a `Driving`) one command-line
option for each of their fields. Nothing heavy is imported here: `--help` stays fast.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from adcbf_cli.commands import completing
from adcbf_cli.core.errors import UsageError

_MOST_SEEDS = 10_000

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
ConfigFile = Annotated[Path | None, typer.Option("--config", "-c", help="YAML file with settings.")]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="STAGE.KEY=VALUE", help="One setting; repeatable.", autocompletion=completing.settings
    ),
]


@dataclass(frozen=True)
class Shared:
    """What every command that works on a log or a run folder takes."""

    source: Annotated[
        Path, typer.Argument(metavar="LOG", help="A log, or the run folder of an earlier command.", show_default=False)
    ]
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Run folder to write; default: <log's stem>.adcbf here.")
    ] = None
    config: ConfigFile = None
    settings: Settings = None
    lidar: Annotated[
        list[str] | None,
        typer.Option(
            "--lidar", metavar="TOPIC", help="LiDAR topic; twice: fuse.", autocompletion=completing.lidar_topics
        ),
    ] = None
    pose: Annotated[
        str | None,
        typer.Option(
            "--pose",
            metavar="TOPIC|tf|none",
            help="Where the sensor was.",
            autocompletion=completing.pose_sources,
        ),
    ] = None
    extrinsic: Annotated[
        list[str] | None,
        typer.Option(
            "--extrinsic",
            metavar="PARENT>CHILD:X,Y,Z,R,P,Y",
            help="A transform that the log lacks (m, rad); repeatable.",
        ),
    ] = None
    world_frame: Annotated[
        str | None, typer.Option("--world-frame", metavar="FRAME", help="Fixed frame, where poses come from tf.")
    ] = None
    deskew: Annotated[
        bool | None, typer.Option("--deskew/--no-deskew", help="Correct motion within a scan; default: on.")
    ] = None
    range_m: Annotated[
        float | None,
        typer.Option("--range", metavar="M", help="Keep points within +-M of the sensor; default 4 (8 x 8 m)."),
    ] = None
    force: Annotated[bool, typer.Option("--force", help="Compute anew what could be reused.")] = False
    viz: Annotated[
        list[str] | None,
        typer.Option(
            "--viz",
            metavar="foxglove|ros2|rrd",
            help="Also write a log for this viewer; repeatable.",
            autocompletion=completing.one_of("foxglove", "ros2", "rrd"),
        ),
    ] = None
    json_output: Json = False

    def overrides(self) -> dict[str, Any]:
        """The dedicated flags as settings; None where a flag was not given."""
        return {
            "read.lidar": tuple(self.lidar) if self.lidar else None,
            "read.pose": self.pose,
            "read.extrinsics": tuple(self.extrinsic) if self.extrinsic else None,
            "read.world_frame": self.world_frame,
            "read.deskew": self.deskew,
            "perception.range_m": self.range_m,
        }


@dataclass(frozen=True)
class Driving:
    """What `plan` and `replay` both take."""

    planner: Annotated[
        list[str] | None,
        typer.Option(
            "--planner",
            "-p",
            metavar="NAME|all",
            help="Planner, repeatable; default ad-cbf-mpc.",
            autocompletion=completing.planners,
        ),
    ] = None
    truth: Annotated[
        str | None,
        typer.Option(
            "--truth",
            "-t",
            metavar="FILE|topic:/NAME",
            help="Where obstacles really were; default: smoothed tracks.",
            autocompletion=completing.truth_topics,
        ),
    ] = None
    reference: Annotated[
        str | None,
        typer.Option(
            "--reference",
            metavar="FILE|topic:/NAME",
            help="Path to follow: CSV or Path; default: the log's.",
            autocompletion=completing.reference_topics,
        ),
    ] = None
    goal: Annotated[
        str | None, typer.Option("--goal", metavar="X,Y", help="Straight to here (m, world), instead of a reference.")
    ] = None
    speed_mps: Annotated[
        float | None, typer.Option("--speed", metavar="MPS", help="Speed along the reference; default 0.75.")
    ] = None
    vehicle: Annotated[
        str | None,
        typer.Option(
            "--vehicle",
            metavar="KIND",
            help="unicycle (default), ackermann.",
            autocompletion=completing.one_of("unicycle", "ackermann"),
        ),
    ] = None
    solver: Annotated[
        str | None,
        typer.Option(
            "--solver",
            metavar="NAME",
            help="sqp (default), piqp, ipopt, fatrop.",
            autocompletion=completing.one_of("sqp", "piqp", "ipopt", "fatrop"),
        ),
    ] = None
    hard: Annotated[
        bool | None, typer.Option("--hard", help="No slack in the barriers; infeasible steps are counted.")
    ] = None
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            metavar="NAME",
            help="Planner that the others are compared with; default: the first.",
            autocompletion=completing.planners,
        ),
    ] = None
    fail_on: Annotated[
        list[str] | None,
        typer.Option("--fail-on", metavar="METRIC>NUMBER", help="Exit with 4 if this holds (< > <= >=); repeatable."),
    ] = None

    def overrides(self) -> dict[str, Any]:
        """The dedicated flags as settings; None where a flag was not given."""
        return {
            "planning.reference_speed_mps": self.speed_mps,
            "vehicle.kind": self.vehicle,
            "planning.solver": self.solver,
            "planning.hard": self.hard or None,
        }


def parse_seeds(text: str) -> tuple[int, ...]:
    """`0:20` (20 not included), `7`, or `1,4,9`: distinct seeds in the order given. UsageError otherwise."""
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,9})\s*(?::\s*(\d{1,9})\s*)?", part)
        if match is None:
            raise UsageError(f"--seeds {text!r}: expected numbers or ranges such as 0:20 or 1,4,9")
        first = int(match[1])
        end = first + 1 if match[2] is None else int(match[2])
        if end - first > _MOST_SEEDS or len(seeds) > _MOST_SEEDS:
            raise UsageError(f"--seeds {text!r}: over {_MOST_SEEDS:,} seeds; run them in parts")
        seeds += range(first, end)
    if not seeds:
        raise UsageError(f"--seeds {text!r}: an empty range")
    return tuple(dict.fromkeys(seeds))


def shared_options(command: Callable[..., None]) -> Callable[..., None]:
    """Replaces each of the command's parameters that is a data class, such as `Shared`, by one option for each of
    its fields."""
    hints = get_type_hints(command, include_extras=True)
    own = list(inspect.signature(command).parameters.values())
    groups = {p.name: hints[p.name] for p in own if dataclasses.is_dataclass(hints[p.name])}

    @functools.wraps(command)
    def wrapper(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in dataclasses.fields(group)})
        command(**given)

    parameters = []
    for parameter in own:
        if parameter.name in groups:
            parameters += _options_of(groups[parameter.name])
        else:
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[parameter.name]))
    wrapper.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    del wrapper.__wrapped__
    return wrapper


def _options_of(group: Any) -> list[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default,
            annotation=hints[field.name],
        )
        for field in dataclasses.fields(group)
    ]
