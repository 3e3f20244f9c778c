"""One pass over a run's records into the logs of any number of viewers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.atomic import write_text_atomically
from adcbf_cli.io.run_folder import Manifest, RunFolder
from adcbf_cli.io.viz import VIEW_FILES
from adcbf_cli.io.viz.items import Item, items
from adcbf_cli.io.viz.layouts import foxglove_layout, rviz_config
from adcbf_cli.io.viz.records import Record, SceneFrame, Show
from adcbf_cli.io.viz.scenes import scenes, show_of


class ViewWriter(Protocol):
    """One viewer's format."""

    def write(self, item: Item) -> None: ...


@dataclass(frozen=True)
class Written:
    """What went into the views: scans, drives, and drives of the folder that were left out."""

    frames: int
    drives: int
    drives_left_out: int


def write_views(
    folder: RunFolder,
    manifest: Manifest,
    names: Sequence[str],
    log: Path | None,
    watched: Callable[[Iterable[Record]], Iterable[Record]] = iter,
) -> Written:
    """Writes the formats `names` (of VIEW_FILES) into the folder, each whole or not at all.

    log: the log that the folder was made from, None to go without points. watched: passes the records on, to show
    progress. AdcbfError where a table or the log cannot be read. Hold the folder's lock.
    """
    show, left_out = show_of(folder, manifest)
    frames = 0
    with ExitStack() as stack:
        writers = [stack.enter_context(_open(name, folder.path / VIEW_FILES[name][0], show)) for name in names]
        for record in watched(scenes(folder, manifest, show, log)):
            if record.stamp_ns < 0:
                raise AdcbfError(
                    f"{folder.path}: its times begin before 1970 ({record.stamp_ns} ns), which no viewer reads"
                )
            if isinstance(record, SceneFrame):
                frames += 1
            for item in items(record, show):
                for writer in writers:
                    writer.write(item)
    for name in names:
        _write_layout(name, folder.path, show)
    return Written(frames, len(show.drives), left_out)


def _open(name: str, path: Path, show: Show) -> AbstractContextManager[ViewWriter]:
    """Each format's module is imported only where it is asked for."""
    if name == "foxglove":
        from adcbf_cli.io.viz.foxglove import open_foxglove

        return open_foxglove(path, show)
    if name == "ros2":
        from adcbf_cli.io.viz.ros2 import open_ros2

        return open_ros2(path, show)
    from adcbf_cli.io.viz.rrd import open_rrd

    return open_rrd(path, show)


_LAYOUTS = {"foxglove": foxglove_layout, "ros2": rviz_config}


def _write_layout(name: str, folder: Path, show: Show) -> None:
    if name in _LAYOUTS:
        write_text_atomically(folder / VIEW_FILES[name][1], _LAYOUTS[name](show))
