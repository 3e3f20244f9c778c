"""Tells the user of plugins that do not come into play."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from adcbf_cli.commands.terminal import say

if TYPE_CHECKING:
    from adcbf_cli.core.plugins import Kind


def tell_overshadowed(kind: Kind, used: Collection[str]) -> None:
    """A line for each installed plugin that has the name of one of these built-in ones, which is what is used."""
    from adcbf_cli.core.plugins import overshadowed

    for plugin in overshadowed(kind, used):
        say(f"warning: {plugin} cannot be used, since that name is built in; it must take another")
