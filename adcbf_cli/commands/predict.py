"""`adcbf predict`: from a log, or a run folder with tracks, to where the obstacles will be."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adcbf_cli.commands.options import Shared, shared_options

if TYPE_CHECKING:
    from adcbf_cli.commands.stages import Outcome

Steps = Annotated[int | None, typer.Option("--steps", metavar="N", help="Steps ahead; default 30.")]
StepTime = Annotated[float | None, typer.Option("--step", metavar="S", help="Seconds a step; default 0.1.")]
CalibrationFile = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="FILE", help="Use this calibration; default: the log's own past."),
]
SaveCalibration = Annotated[
    Path | None, typer.Option("--save-calibration", metavar="FILE", help="Learn one from this log, for use on others.")
]


@shared_options
def predict(
    shared: Shared,
    steps: Steps = None,
    step_s: StepTime = None,
    calibration_file: CalibrationFile = None,
    save_calibration: SaveCalibration = None,
) -> None:
    """Predict where each track will be.

    N steps of position, covariance and calibrated radius for every confirmed track and frame.

    Writes `predictions.parquet`; clusters and tracks first, where they are not there yet.

    Examples:

        adcbf predict log.mcap

        adcbf predict log.adcbf --steps 50 --step 0.1

        adcbf predict monday.mcap --save-calibration monday.json

        adcbf predict tuesday.mcap --calibration monday.json
    """
    from adcbf_cli.commands.stages import plan_job, run_stages
    from adcbf_cli.commands.summary import finish
    from adcbf_cli.commands.viz import write_viz
    from adcbf_cli.io.atomic import check_target

    overrides = {
        "prediction.steps": steps,
        "prediction.step_s": step_s,
        "prediction.calibration": "file" if calibration_file else None,
    }
    job = plan_job(shared, overrides, calibration_file)
    if save_calibration is not None:
        check_target(save_calibration)
    outcome = run_stages(job, "predict", shared.force)
    if save_calibration is not None:
        _save_calibration(save_calibration, outcome)
    write_viz(outcome, shared.viz)
    finish(outcome, "predict", shared.json_output)


def _save_calibration(target: Path, outcome: Outcome) -> None:
    """Writes the conformal radii that all of this log's tracks give, for logs to come."""
    import json

    from adcbf_cli.core.prediction.predictor import learn_calibration
    from adcbf_cli.io.atomic import write_text_atomically
    from adcbf_cli.io.tables import read_tracks

    config, source = outcome.manifest.config, outcome.manifest.source
    calibration = learn_calibration(
        read_tracks(outcome.folder.path), config.prediction, config.tracking, outcome.notes, source.name
    )
    write_text_atomically(target, json.dumps(calibration.to_dict(), indent=2, allow_nan=False) + "\n")
