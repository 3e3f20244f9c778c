"""The drives that `plan` and `replay` left in a run folder, scored again by `evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.run_folder import DRIVING, RunFolder

if TYPE_CHECKING:
    from adcbf_cli.commands.stages import Job, Outcome
    from adcbf_cli.core.config import PlanningConfig, ReplayConfig
    from adcbf_cli.core.evaluation.report import Report
    from adcbf_cli.core.replay.records import Drive

Table = tuple[list[str], list[list[str]]]


@dataclass(frozen=True)
class Stored:
    """One kind of driving: its drives, the settings they were driven with, the predictions they rest on."""

    kind: str
    drives: list[Drive]
    replay: ReplayConfig
    planning: PlanningConfig
    against: str | None
    key: str


@dataclass(frozen=True)
class StoredDrives:
    """Every kind of driving that the run folder holds whole."""

    kinds: tuple[Stored, ...]
    cut_short: tuple[str, ...]
    """Kinds of which some files are there, but not all: what a killed command leaves."""

    def metric_names(self) -> list[str]:
        from adcbf_cli.core.evaluation.comparison import metric_names

        return [
            name
            for stored in self.kinds
            for name in metric_names(_kind(stored.kind), dict.fromkeys(drive.planner for drive in stored.drives))
        ]

    def compare(self, outcome: Outcome, report: Report) -> list[tuple[str, Table]]:
        """Adds each kind's metrics to the report, and gives its table with a title. Drives along predictions that
        are no longer the folder's are left out, and the user is told."""
        from adcbf_cli.core.evaluation.comparison import add_to_report, compare
        from adcbf_cli.core.evaluation.comparison_text import headline

        for kind in self.cut_short:
            outcome.notes.warn(f"{DRIVING[kind]}/ is not whole, and left out: run `adcbf {kind}` again")
        shown = []
        for stored in self.kinds:
            if stored.key != outcome.manifest.stages["predict"].key:
                outcome.notes.warn(f"{DRIVING[stored.kind]}/ was made of other predictions: run `adcbf {stored.kind}`")
                continue
            comparison = compare(stored.drives, stored.replay, stored.planning, stored.against)
            add_to_report(comparison, report)
            shown.append((f"{outcome.folder.path / DRIVING[stored.kind]}", headline(comparison)))
        return shown


def _kind(name: str) -> Any:
    return "plan" if name == "plan" else "replay"


def stored_drives(job: Job) -> StoredDrives:
    """What the job's run folder holds, read before anything is computed."""
    found = [_stored(job.folder, kind) for kind in DRIVING]
    whole = {stored.kind for stored in found if stored is not None}
    cut_short = [k for k in DRIVING if k not in whole and any((job.folder.path / DRIVING[k]).glob("*.parquet"))]
    return StoredDrives(tuple(stored for stored in found if stored is not None), tuple(cut_short))


def _stored(folder: RunFolder, kind: str) -> Stored | None:
    from pydantic import ValidationError

    from adcbf_cli.core.config import PlanningConfig, ReplayConfig
    from adcbf_cli.io.driving_tables import read_drives
    from adcbf_cli.io.parquet import table_metadata

    key = folder.driving_key(kind)
    place = folder.path / DRIVING[kind]
    metadata = table_metadata(place / "drives.parquet")
    if key is None or metadata is None:
        return None
    try:
        replay = ReplayConfig.model_validate(metadata["config"]["replay"])
        planning = PlanningConfig.model_validate(metadata["config"]["planning"])
        against = metadata["against"]
    except (ValidationError, LookupError, TypeError):
        raise AdcbfError(f"{place}: its settings are not this adcbf's; run `adcbf {kind}` again") from None
    return Stored(kind, read_drives(place), replay, planning, against, key)
