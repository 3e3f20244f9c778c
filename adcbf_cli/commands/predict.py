"""`adcbf predict`: from a log, or a run folder with tracks, to where the obstacles will be."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from adcbf_cli.commands.options import Shared, shared_options

Steps = Annotated[int | None, typer.Option("--steps", metavar="N", help="Steps ahead; default 30.")]
StepTime = Annotated[float | None, typer.Option("--step", metavar="S", help="Seconds a step; default 0.1.")]
CalibrationFile = Annotated[
    Path | None, typer.Option("--calibration", help="Calibration file; default: the log's own past.")
]


@shared_options
def predict(
    shared: Shared, steps: Steps = None, step_s: StepTime = None, calibration_file: CalibrationFile = None
) -> None:
    """Predict every confirmed track: N steps of position, covariance and calibrated radius.

    Writes `predictions.parquet`; clusters and tracks first, where they are not there yet.

    Examples:

        adcbf predict log.mcap

        adcbf predict log.adcbf --steps 50 --step 0.1

        adcbf predict log.adcbf --calibration calibration.json
    """
    from adcbf_cli.commands.stages import plan_job, run_stages
    from adcbf_cli.commands.summary import finish

    overrides = {
        "prediction.steps": steps,
        "prediction.step_s": step_s,
        "prediction.calibration": "file" if calibration_file else None,
    }
    job = plan_job(shared, overrides, calibration_file)
    finish(run_stages(job, "predict", shared.force), "predict", shared.json_output)
