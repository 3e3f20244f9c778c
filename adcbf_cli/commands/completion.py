"""`adcbf completion`: the script that makes a shell complete adcbf's commands, options, topics and settings."""

from __future__ import annotations

from typing import Annotated

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.completion_scripts import SCRIPTS
from adcbf_cli.core.errors import UsageError


def completion(
    shell: Annotated[
        str,
        typer.Argument(
            metavar="SHELL",
            show_default=False,
            help="bash, zsh or fish.",
            autocompletion=completing.one_of(*SCRIPTS),
        ),
    ],
) -> None:
    """Print the script that completes commands in a shell.

    Commands and options; topics of the log that the line names; planners, scenarios, settings and their values.
    Load it once to try it, or keep it where the shell looks for such scripts.

    Examples:

        source <(adcbf completion bash)          # in ~/.bashrc, to have it in every shell

        source <(adcbf completion zsh)           # in ~/.zshrc, below compinit

        adcbf completion fish > ~/.config/fish/completions/adcbf.fish
    """
    if shell not in SCRIPTS:
        raise UsageError(f"{shell}: no shell that adcbf completes in ({', '.join(SCRIPTS)})")
    print(SCRIPTS[shell], end="")
