"""`adcbf completion`: the script that makes a shell complete adcbf's commands, options, topics and settings."""

from __future__ import annotations

import enum
from typing import Annotated

import typer

from adcbf_cli.commands.completion_scripts import SCRIPTS


class Shell(enum.StrEnum):
    bash = "bash"
    zsh = "zsh"
    fish = "fish"


def completion(
    shell: Annotated[Shell, typer.Argument(metavar="SHELL", show_default=False, help="bash, zsh or fish.")],
) -> None:
    """Print the script that completes commands in a shell.

    Commands and options; topics of the log that the line names; planners, scenarios, settings and their values.
    Load it once to try it, or keep it where the shell looks for such scripts.

    Examples:

        source <(adcbf completion bash)          # in ~/.bashrc, to have it in every shell

        source <(adcbf completion zsh)           # in ~/.zshrc, below compinit

        adcbf completion fish > ~/.config/fish/completions/adcbf.fish
    """
    print(SCRIPTS[shell.value], end="")
