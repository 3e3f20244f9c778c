"""`adcbf config`: the settings in force, and what they mean."""

from __future__ import annotations

import typer

from adcbf_cli.commands.options import ConfigFile, Settings

app = typer.Typer(no_args_is_help=True, help="Show the settings, or their schema.")


@app.command()
def dump(config: ConfigFile = None, settings: Settings = None) -> None:
    """Print every setting in force as YAML, ready to be edited and given to --config.

    Examples:

        adcbf config dump > run.yaml

        adcbf config dump --set tracking.filter=ekf
    """
    from adcbf_cli.core.config import Config
    from adcbf_cli.io.settings import resolve_config, settings_yaml

    print(settings_yaml(resolve_config(Config(), config, settings or ())), end="")


@app.command()
def schema() -> None:
    """Print the JSON schema of the settings: types, bounds, defaults, meaning.

    Example:

        adcbf config schema > adcbf.schema.json
    """
    from adcbf_cli.commands.terminal import print_json
    from adcbf_cli.core.config import Config

    print_json(Config.model_json_schema())
