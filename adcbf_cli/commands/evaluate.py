"""`adcbf evaluate`: how good the obstacles, tracks and predictions of a run are."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.options import Shared, shared_options
from adcbf_cli.commands.terminal import print_json, print_table, say, show_notes
from adcbf_cli.core.errors import EXIT_THRESHOLD

if TYPE_CHECKING:
    from adcbf_cli.commands.stages import Job, Outcome
    from adcbf_cli.core.config import Config, EvaluationConfig
    from adcbf_cli.core.evaluation.report import Report
    from adcbf_cli.core.evaluation.thresholds import Threshold
    from adcbf_cli.core.types import Notes, Truth
    from adcbf_cli.io.truth import PlaceTruth

TruthOption = Annotated[
    str | None,
    typer.Option(
        "--truth",
        "-t",
        metavar="FILE|topic:/NAME",
        help="Ground truth: CSV, KITTI labels, TUM poses, or a pose topic.",
        autocompletion=completing.truth_topics,
    ),
]
FailOn = Annotated[
    list[str] | None,
    typer.Option("--fail-on", metavar="METRIC>NUMBER", help="Exit with 4 if this holds (< > <= >=); repeatable."),
]


@shared_options
def evaluate(shared: Shared, truth: TruthOption = None, fail_on: FailOn = None) -> None:
    """Score obstacles, tracks and predictions.

    Each number comes with its unit and its number of samples. Drives that `plan` and `replay` left in the run folder
    are scored too, planner by planner.

    Without ground truth, predictions are held against where the same track was later seen. Runs the
    stages first, where they are not there yet; writes `report.json` and `report.md`.

    Examples:

        adcbf evaluate log.mcap --truth labels.csv --range 20

        adcbf evaluate log.bag --pose /ego_pose --truth topic:/red_pose

        adcbf evaluate log.adcbf -t truth.csv --fail-on "detection.recall<0.9" --fail-on "prediction.rmse_x_m>0.1"
    """
    score_run(shared, truth, fail_on or [], with_facts=False)


def score_run(shared: Shared, truth: str | None, fail_on: list[str], with_facts: bool) -> None:
    """Runs the stages that are missing, evaluates, writes the report, prints it, sets the exit code.

    with_facts: show the stages' own summary too, as `adcbf run` does.
    """
    from adcbf_cli.commands.stages import plan_job, run_stages
    from adcbf_cli.commands.stored_drives import stored_drives
    from adcbf_cli.commands.summary import exit_for, print_facts, summarise
    from adcbf_cli.commands.viz import write_viz
    from adcbf_cli.core.evaluation.thresholds import check_names, missed, parse_threshold
    from adcbf_cli.io.report import report_document, write_report
    from adcbf_cli.io.score_blocks import write_score_blocks
    from adcbf_cli.io.truth import read_truth_option

    thresholds = [parse_threshold(text) for text in fail_on]
    job = plan_job(shared)
    drives = stored_drives(job)
    if thresholds:
        check_names(thresholds, [*possible_metrics(job.config.evaluation), *drives.metric_names()])
    # Before the work: a bad file costs no time.
    place_truth = None if truth is None else read_truth_option(truth, job.log)
    outcome = run_stages(job, "predict", shared.force)
    report = score(job, outcome, place_truth, outcome.notes)
    comparisons = drives.compare(outcome, report)
    failures = missed(thresholds, report)
    document = report_document(report, _provenance(outcome, truth, thresholds, failures))
    with outcome.folder.locked():
        write_report(outcome.folder.path, document, report)
        write_score_blocks(outcome.folder.path, report.metrics)
    write_viz(outcome, shared.viz)
    if with_facts:
        facts = summarise(outcome, "predict")
        document = {"run": facts, "report": document}
    if shared.json_output:
        print_json(document)
    else:
        if with_facts:
            print_facts(outcome, facts)
        _print_report(outcome.folder.path, report)
        for title, table in comparisons:
            print_table(title, *table)
    show_notes(outcome.notes)
    for line in failures:
        say(f"threshold missed: {line}")
    if failures:
        raise typer.Exit(EXIT_THRESHOLD)
    exit_for(outcome)


def score(job: Job, outcome: Outcome, place_truth: PlaceTruth | None, notes: Notes) -> Report:
    """Evaluates the tables of a finished run; the run's own warnings and the evaluation's go to `notes`."""
    from adcbf_cli.core.evaluation.evaluate import evaluate as evaluate_records
    from adcbf_cli.io.tables import read_clusters, read_predictions, read_tracks

    folder = outcome.folder.path
    config = scoring_config(job.config, notes)
    truth = None if place_truth is None else placed_truth(place_truth, job, outcome, notes)
    return evaluate_records(
        read_clusters(folder), read_tracks(folder), partial(read_predictions, folder), truth, config, notes
    )


def scoring_config(config: Config, notes: Notes) -> EvaluationConfig:
    """The evaluation's settings with the range filled in: as far as perception looked, unless set."""
    seen_m, wanted_m = config.perception.range_m, config.evaluation.range_m
    if wanted_m is not None and wanted_m > seen_m:
        notes.warn(
            f"evaluation.range_m is {wanted_m:g} m but perception.range_m {seen_m:g} m: objects between count as missed"
        )
    return config.evaluation.model_copy(update={"range_m": seen_m if wanted_m is None else wanted_m})


def possible_metrics(config: EvaluationConfig) -> list[str]:
    """The names of all metrics that an evaluation with ground truth gives, whatever the data."""
    import numpy as np

    from adcbf_cli.core.evaluation.evaluate import evaluate as evaluate_records
    from adcbf_cli.core.types import Notes, Truth

    none, no_ids = np.zeros(0), np.zeros(0, dtype=np.int64)
    empty = Truth("world", no_ids, no_ids, (), np.zeros((0, 3)), none, none, none, none)
    return list(evaluate_records((), (), tuple, empty, config, Notes()).metrics)


def placed_truth(place_truth: PlaceTruth, job: Job, outcome: Outcome, notes: Notes) -> Truth:
    """The truth at the run's frames, in its world. Warns where it is the robot itself."""
    import numpy as np

    from adcbf_cli.core.evaluation.own_pose import rides_along
    from adcbf_cli.core.evaluation.scene import truth_in_world
    from adcbf_cli.io.parquet import read_table
    from adcbf_cli.io.tables import read_clusters
    from adcbf_cli.io.truth import TruthContext

    frames = read_table(outcome.folder.table("frames"), columns=["frame_index", "timestamp_ns"])
    context = TruthContext(
        frame_index=frames["frame_index"].to_numpy(),
        stamp_ns=frames["timestamp_ns"].to_numpy(),
        log=job.log,
        world_frame=outcome.manifest.selection.get("world_frame"),
        kitti_first_frame=job.config.evaluation.truth_first_frame,
    )
    poses = [(record.stamp_ns, record.world_from_sensor) for record in read_clusters(outcome.folder.path)]
    truth = truth_in_world(place_truth(context, notes), poses, notes)
    stamps, transforms = np.array([stamp for stamp, _ in poses]), np.array([pose for _, pose in poses])
    riders = rides_along(truth, stamps, transforms)
    if riders:
        what = f"object {riders[0]} of it" if len(riders) < len(set(truth.track_id.tolist())) else "it"
        notes.warn(f"{truth.source}: {what} moves as the sensor does; is it the robot's own pose?")
    return truth


def _provenance(
    outcome: Outcome, truth_spec: str | None, thresholds: list[Threshold], failures: list[str]
) -> dict[str, Any]:
    """What the report says of the run that it scores."""
    import hashlib

    truth_sha256 = None
    if truth_spec is not None and Path(truth_spec).is_file():
        with Path(truth_spec).open("rb") as handle:
            truth_sha256 = hashlib.file_digest(handle, "sha256").hexdigest()
    return {
        "source": {"name": outcome.manifest.source.name, "sha256": outcome.manifest.source.sha256},
        "truth_sha256": truth_sha256,
        "thresholds": [str(t) for t in thresholds],
        "thresholds_missed": failures,
        "warnings": outcome.notes.warnings,
        "losses": [{"what": loss.what, "count": loss.count} for loss in outcome.notes.losses],
    }


def _print_report(folder: Path, report: Report) -> None:
    """The metrics most looked at; report.md has them all, with their definitions."""
    from adcbf_cli.core.evaluation.headlines import is_headline
    from adcbf_cli.io.report import MARKDOWN_NAME, interval, number, unit

    rows = [
        (name, number(metric.value), interval(metric), unit(metric), f"{metric.n:,}")
        for name, metric in report.metrics.items()
        if is_headline(name, report.basis["truth"] is not None)
    ]
    print_table(f"{folder}: evaluation", ("metric", "value", "95 % interval", "unit", "n"), rows)
    say(f"all {len(report.metrics)} metrics and their definitions: {folder / MARKDOWN_NAME}")
