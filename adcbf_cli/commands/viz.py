"""`--viz`: logs for viewers, written into the run folder after a command's tables are there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adcbf_cli.commands.terminal import progress, say
from adcbf_cli.core.errors import UsageError

if TYPE_CHECKING:
    from adcbf_cli.commands.stages import Outcome


def check_viz(names: Sequence[str] | None) -> None:
    """UsageError for a format that there is not, or whose package is missing. Asked before the work."""
    from importlib.util import find_spec

    from adcbf_cli.io.viz import VIEW_FILES

    for name in names or ():
        if name not in VIEW_FILES:
            raise UsageError(f"--viz {name!r}: must be one of {', '.join(VIEW_FILES)}")
    if "rrd" in (names or ()) and find_spec("rerun") is None:
        raise UsageError("--viz rrd needs Rerun's SDK, which is not installed: pip install 'adcbf[rerun]'")


def write_viz(outcome: Outcome, names: Sequence[str] | None) -> None:
    """Writes the asked formats from what the run folder holds; says where, and what is missing."""
    if not names:
        return
    from adcbf_cli.io.viz import VIEW_FILES
    from adcbf_cli.io.viz.writing import write_views

    wanted = tuple(dict.fromkeys(names))
    total = outcome.manifest.stages["cluster"].rows.get("frames")

    def watched(records: Iterable[Any]) -> Iterable[Any]:
        return progress(records, total, "viz")

    log, why_not = _log_for_points(outcome)
    if why_not:
        say(f"--viz: without the cloud: {why_not}")
    with outcome.folder.locked():
        written = write_views(outcome.folder, outcome.manifest, wanted, log, watched)
    for name in wanted:
        files = " and ".join(str(outcome.folder.path / file) for file in VIEW_FILES[name])
        say(f"{files}: {written.frames:,} scans, {written.drives} drives")
    if written.drives_left_out:
        say(f"--viz shows the first seed of each planner; {written.drives_left_out} more drives are in the tables")


def _log_for_points(outcome: Outcome) -> tuple[Path | None, str]:
    """The log, where it is still the one that the folder was made from; else why not ("" where it has no points)."""
    from adcbf_cli.io.run_folder import is_source

    source = outcome.manifest.source
    log = outcome.folder.path / source.path
    if log.suffix.lower() == ".csv":  # an object list
        return None, ""
    if not log.exists():
        return None, f"{log} is gone"
    just_read = "cluster" in outcome.computed
    if not just_read and not is_source(log, source):
        return None, f"{log} has changed since the run folder was made"
    return log, ""
