"""The options that several commands share, declared once.

`@shared_options` gives a command function, whose first parameter is a `Shared`, one command-line
option for each of `Shared`'s fields. Nothing heavy is imported here: `--help` stays fast.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")]
ConfigFile = Annotated[Path | None, typer.Option("--config", "-c", help="YAML file with settings.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="STAGE.KEY=VALUE", help="One setting; repeatable."),
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
        typer.Option("--lidar", metavar="TOPIC", help="LiDAR topic; twice: fuse."),
    ] = None
    pose: Annotated[
        str | None,
        typer.Option("--pose", metavar="TOPIC|tf|none", help="Where the sensor was."),
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


def shared_options(command: Callable[..., None]) -> Callable[..., None]:
    """Replaces the command's first parameter, a `Shared`, by one option for each of its fields."""
    own = list(inspect.signature(command).parameters.values())[1:]
    hints = get_type_hints(command, include_extras=True)
    shared_hints = get_type_hints(Shared, include_extras=True)
    shared_fields = dataclasses.fields(Shared)

    @functools.wraps(command)
    def wrapper(**given: Any) -> None:
        shared = Shared(**{field.name: given.pop(field.name) for field in shared_fields})
        command(shared, **given)

    parameters = [
        inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default,
            annotation=shared_hints[field.name],
        )
        for field in shared_fields
    ] + [p.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[p.name]) for p in own]
    wrapper.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    wrapper.__annotations__ = {p.name: p.annotation for p in parameters}
    del wrapper.__wrapped__
    return wrapper
