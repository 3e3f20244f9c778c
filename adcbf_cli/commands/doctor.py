"""`adcbf doctor`: is this installation whole, and what is to be done where it is not."""

from __future__ import annotations

import typer

from adcbf_cli.commands.options import Json
from adcbf_cli.core.errors import EXIT_FAILED


def doctor(json_output: Json = False) -> None:
    """Check this installation: packages, system libraries, solvers, plugins, and a self-test.

    The self-test runs a scene that is known exactly through every stage and plans once, in seconds; the first time,
    the fast solver is compiled. Every row that is not `ok` says what to do.

    Exits with 1 where something required has failed; extras that are absent, and what adcbf does without, are no
    failure.

    Examples:

        adcbf doctor

        adcbf doctor --json > doctor.json
    """
    from adcbf_cli.commands.doctor_checks import all_checks
    from adcbf_cli.commands.terminal import print_json

    checks = []
    for check in all_checks():
        checks.append(check)
        if not json_output:  # each as it is known: some take a moment
            print(f"{check.state:<8} {check.name:<20} {check.detail}", flush=True)
            if check.advice:
                print(f"{'':<8} {'':<20} -> {check.advice}", flush=True)
    failed = any(check.state == "failed" for check in checks)
    if json_output:
        print_json({"schema_version": 1, "ok": not failed, "checks": [check.to_dict() for check in checks]})
    if failed:
        raise typer.Exit(EXIT_FAILED)
