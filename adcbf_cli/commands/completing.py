"""What the shell offers for an argument's value when somebody presses Tab.

Called for each press, so nothing is imported before it is needed; and silent, whatever happens: an error message
in the middle of a half-typed command helps nobody.
"""

from __future__ import annotations

import glob
import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import typer

LINE = "_TYPER_COMPLETE_ARGS"
"""In the environment: the line up to the cursor, from the completion script."""

_MEANING_LENGTH = 60

Offer = tuple[str, str]
"""A value, and what it is."""
_Completer = Callable[[typer.Context, str], Iterable[Offer]]

_SAFE = re.compile(r"[\w./:~=<>,+-]+", re.ASCII)
"""What a shell takes as it is. A log's topic may be called anything, and what is offered here lands on the command
line."""


def _offers(complete: _Completer) -> Callable[[typer.Context, str], list[Offer]]:
    def silent(ctx: typer.Context, incomplete: str) -> list[Offer]:
        try:
            found = list(complete(ctx, incomplete))
        except (Exception, SystemExit):  # a log of any kind, a plugin of any kind
            return []
        return [
            (value, _shortened(text))
            for value, text in found
            if value.startswith(incomplete) and _SAFE.fullmatch(value)
        ]

    return silent


def _shortened(text: str) -> str:
    """One line of a terminal holds it beside the value."""
    return text if len(text) <= _MEANING_LENGTH else f"{text[: _MEANING_LENGTH - 3].rstrip()}..."


def one_of(*values: str) -> Callable[[typer.Context, str], list[Offer]]:
    """Of a few fixed values."""
    return _offers(lambda ctx, incomplete: [(value, "") for value in values])


def behind_dashes(line: str) -> str:
    """The line whose offers are those of `line`: of `adcbf batch LOGS -- COMMAND OPTIONS` that of the command itself,
    with the logs on it, since topics are asked of them."""
    before, dashes, after = line.partition(" -- ")
    words = before.split()
    if not dashes or words[1:2] != ["batch"]:
        return line
    logs = [word for word in words[2:] if not word.startswith("-")]
    name, space, options = after.lstrip().partition(" ")
    if name.startswith("-"):
        name, space, options = "run", " ", after.lstrip()
    return " ".join([words[0], name, *logs, options]) if space else line


@_offers
def batch_commands(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Of a batch behind its --; before it there are logs, which the shell offers."""
    from adcbf_cli.commands.batch_work import COMMANDS

    if "--" in shlex.split(os.environ[LINE]):
        yield from ((name, "") for name in COMMANDS)


@_offers
def lidar_topics(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.io.ros_messages import LIDAR_TYPES

    return _topics(LIDAR_TYPES)


@_offers
def pose_sources(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.io.ros_messages import POSE_TYPES

    yield from _topics(POSE_TYPES)
    yield from (("tf", "the log's transforms"), ("none", "the sensor stands still"))


@_offers
def truth_topics(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.io.ros_messages import POSE_TYPES

    return _topics(POSE_TYPES, "topic:")


@_offers
def reference_topics(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.io.ros_messages import PATH

    return _topics((PATH,), "topic:")


def _topics(types: Iterable[str], prefix: str = "") -> Iterator[Offer]:
    """Those of the first log on the line, or that a pattern there matches. The line itself is looked at: an option
    without its value, which is what is being completed, ends the parser's work before it comes to the log."""
    from adcbf_cli.io.stored_topics import stored_topics

    words = [os.path.expanduser(word) for word in shlex.split(os.environ[LINE])[2:]]
    logs = (word if os.path.exists(word) else next(glob.iglob(word), None) for word in words)
    for name, kind in next(filter(None, (stored_topics(Path(log)) for log in logs if log is not None)), {}).items():
        if kind in types:
            yield prefix + name, kind.rpartition("/")[2]


@_offers
def planners(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.core.planning.names import PLANNER_NAMES

    yield from ((name, "") for name in PLANNER_NAMES)
    yield from _plugins("PLANNER")
    yield "all", "all that are built in"


@_offers
def clusterers(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.core.config import CLUSTERERS

    yield from ((name, "") for name in CLUSTERERS)
    yield from _plugins("CLUSTERER")


@_offers
def motion_models(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.core.config import MOTION_MODELS

    yield from ((name, "") for name in MOTION_MODELS)
    yield from _plugins("MOTION_MODEL")


def _plugins(kind: str) -> Iterator[Offer]:
    from adcbf_cli.core.plugins import Kind, plugins

    return ((plugin.name, f"of {plugin.distribution}") for plugin in plugins(Kind[kind]))


@_offers
def scenarios(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    from adcbf_cli.scenarios import scenario_names

    return ((name, "comes along") for name in scenario_names())


@_offers
def settings(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Keys with their meaning, and after the = the values of those that have a few."""
    from adcbf_cli.core.config import Config
    from adcbf_cli.io.settings import known_keys

    key, equals, _ = incomplete.partition("=")
    if equals:
        yield from ((f"{key}={value}", text) for value, text in _values(key, ctx))
        return
    for name in known_keys():
        stage, _, field = name.partition(".")
        meaning = Config.model_fields[stage].annotation.model_fields[field].description  # type: ignore[union-attr]
        yield f"{name}=", meaning or ""


def _values(key: str, ctx: typer.Context) -> Iterable[Offer]:
    from typing import Literal, get_args, get_origin

    from adcbf_cli.core.config import Config

    named = {"perception.clusterer": clusterers, "tracking.model": motion_models}
    if key in named:
        return named[key](ctx, "")
    stage, _, field = key.partition(".")
    kind = Config.model_fields[stage].annotation.model_fields[field].annotation  # type: ignore[union-attr]
    choices = get_args(kind) if get_origin(kind) is Literal else ("true", "false") if kind is bool else ()
    return [(str(choice), "") for choice in choices]
