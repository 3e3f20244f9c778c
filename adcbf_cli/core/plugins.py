"""Planners, clusterers and motion models of other packages, found by the entry points they declare.

A package that declares, in its pyproject.toml,

    [project.entry-points."adcbf.planners"]
    creep = "my_package.planners:make_creep"

adds the planner `creep`. What is built in needs no look-up and is never replaced; a package is imported only
when a name of its is asked for, so that a broken one disturbs nobody else.
"""

from __future__ import annotations

import difflib
import enum
import re
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, distribution, distributions
from typing import Any

from adcbf_cli.core.errors import AdcbfError, UsageError

_NAME = re.compile("[a-z0-9][a-z0-9_-]*")
"""Names become parts of metrics' and folders' names."""

_STOPPED = 128
"""Exit codes above it are those of a process that a signal told to leave, wherever it was just then."""


class Kind(enum.StrEnum):
    """What a package may add; the value is the entry points' group."""

    PLANNER = "adcbf.planners"
    CLUSTERER = "adcbf.clusterers"
    MOTION_MODEL = "adcbf.motion_models"

    @property
    def noun(self) -> str:
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True, slots=True)
class Plugin:
    """A name that an installed package offers. target: `module:attribute`."""

    kind: Kind
    name: str
    distribution: str
    version: str
    target: str

    @property
    def module(self) -> str:
        return self.target.partition(":")[0].strip()

    def __str__(self) -> str:
        return f"the {self.kind.noun} {self.name!r} of {self.distribution} {self.version}"


def plugins(kind: Kind) -> list[Plugin]:
    """Everything that installed packages offer, by name; two packages may offer the same one."""
    return sorted((plugin for plugin in _declared(tuple(sys.path)) if plugin.kind is kind), key=_by_name)


def find_plugin(kind: Kind, name: str, built_in: Collection[str]) -> Plugin:
    """The plugin of this name, not loaded. UsageError where there is none, or more than one."""
    offered = plugins(kind)
    found = [plugin for plugin in offered if plugin.name == name]
    if len(found) > 1:
        packages = " and ".join(f"{plugin.distribution} {plugin.version}" for plugin in found)
        raise UsageError(f"{packages} both offer a {kind.noun} called {name!r}; uninstall one of them")
    if not found:
        known = list(dict.fromkeys([*built_in, *(plugin.name for plugin in offered)]))
        close = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        hint = f"did you mean {close[0]}? " if close else ""
        raise UsageError(f"no {kind.noun} is called {name!r}; {hint}there are {', '.join(known)}")
    if _NAME.fullmatch(name) is None:
        raise malformed(found[0], "a name is of lower-case letters, digits, - and _")
    return found[0]


def load_plugin(plugin: Plugin) -> Callable[..., Any]:
    """What the plugin's target names, to be called. UsageError where that cannot be had; and when it is called,
    where it raises, or returns what is not of its kind."""
    with _named(plugin, f"cannot be loaded from {plugin.target!r}"):
        made = EntryPoint(plugin.name, plugin.target, plugin.kind).load()
    if not callable(made):
        raise UsageError(f"{plugin}: {plugin.target!r} is a {type(made).__name__}, where something to call is wanted")
    wanted, attributes = _RETURNS.get(plugin.kind, ("", ()))
    make = guarded(plugin, made)

    def call(*given: Any) -> Any:
        found = make(*given)
        if not all(hasattr(found, attribute) for attribute in attributes):
            raise malformed(plugin, f"it returns a {type(found).__name__}, where a {wanted} is wanted")
        return found

    return call


def guarded(plugin: Plugin, function: Callable[..., Any]) -> Callable[..., Any]:
    """The plugin's function, with a UsageError that names the plugin in place of whatever it raises."""

    def call(*given: Any) -> Any:
        with _named(plugin, "failed"):
            return function(*given)

    return call


_RETURNS = {
    Kind.CLUSTERER: ("Grouping", ("label", "probability")),
    Kind.MOTION_MODEL: (
        "MotionModel",
        ("dimension", "linear", "propagate", "jacobian", "process_noise", "initial_variance"),
    ),
}
"""What is returned to those that call, and what it has; of planners, `make_planner` makes sure itself."""


@contextmanager
def _named(plugin: Plugin, what: str) -> Iterator[None]:
    """Whatever a stranger's code raises, as one line that names it."""
    try:
        yield
    except AdcbfError:
        raise
    except (Exception, SystemExit) as error:
        if isinstance(error, SystemExit) and isinstance(error.code, int) and error.code > _STOPPED:
            raise
        reason = " ".join(str(error).split()) or "no reason given"
        raise UsageError(
            f"{plugin} {what} ({type(error).__name__}: {reason:.200}); mend or uninstall that package"
        ) from error


def malformed(plugin: Plugin, what: str) -> UsageError:
    """For what a plugin made that is not of the kind that it says."""
    return UsageError(f"{plugin}: {what}; see docs/extending.md")


def overshadowed(kind: Kind, names: Collection[str]) -> list[Plugin]:
    """Plugins that cannot be reached, since one of these built-in `names` is theirs."""
    return [plugin for plugin in plugins(kind) if plugin.name in names]


@lru_cache(maxsize=4)
def _declared(path: tuple[str, ...]) -> tuple[Plugin, ...]:
    """What all packages on sys.path declare; of one that lies there twice, the first counts. Looked through once: that
    takes a while, and what is installed does not change while a process runs."""
    found: dict[str, list[Plugin]] = {}
    for package in distributions():
        try:
            offers = _offers(package)
            if offers:
                name = offers[0].distribution
                found.setdefault(re.sub("[-_.]+", "-", name).lower(), _offers(_first(package, name)))
        except Exception:  # one package's damaged metadata must not stand in the way of all others
            continue
    return tuple(plugin for offers in found.values() for plugin in offers)


def _first(package: Distribution, name: str) -> Distribution:
    """The package of this name that imports find: one that offers something may be behind one that does not."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return package


def _offers(package: Distribution) -> list[Plugin]:
    groups = {str(kind): kind for kind in Kind}
    points = [point for point in package.entry_points if point.group in groups]
    if not points:
        return []
    name, version = str(package.name or "a package"), str(package.version or "of unknown version")
    return [Plugin(groups[point.group], point.name, name, version, point.value) for point in points]


def _by_name(plugin: Plugin) -> tuple[str, str]:
    return plugin.name, plugin.distribution
