"""Which packages' plugins took part in a run, down to their sources: for provenance, and so that what one version
computed is not taken for another's."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec
from pathlib import Path

from adcbf_cli.core.config import CLUSTERERS, MOTION_MODELS, Config
from adcbf_cli.core.plugins import Kind, Plugin, find_plugin

_SOURCES = (".py", *EXTENSION_SUFFIXES)


def stage_plugins(config: Config) -> dict[str, str]:
    """By setting, the versions of the plugins that the stages use; empty where all that they use is built in."""
    asked = (
        ("perception.clusterer", Kind.CLUSTERER, config.perception.clusterer, CLUSTERERS),
        ("tracking.model", Kind.MOTION_MODEL, config.tracking.model, MOTION_MODELS),
    )
    return {
        key: plugin_version(find_plugin(kind, name, built_in))
        for key, kind, name, built_in in asked
        if name not in built_in
    }


def planner_plugins(names: Collection[str], built_in: Collection[str]) -> dict[str, str]:
    """By planner, the versions of those that packages offer."""
    return {name: plugin_version(find_plugin(Kind.PLANNER, name, built_in)) for name in names if name not in built_in}


def plugin_version(plugin: Plugin) -> str:
    """Distribution, version, and a hash of the sources and compiled modules of its package: one that is installed
    in place changes without its version."""
    digest = hashlib.sha256()
    for name, path in _files(plugin.module.partition(".")[0]):
        digest.update(name.encode() + b"\0" + path.read_bytes())
    return f"{plugin.distribution} {plugin.version}+{digest.hexdigest()[:16]}"


def _files(package: str) -> Iterator[tuple[str, Path]]:
    """The package's source files, by their names within it; nothing where it is not to be found."""
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        return
    if spec is None:
        return
    if spec.submodule_search_locations is None:
        if spec.origin is not None and Path(spec.origin).is_file():
            yield Path(spec.origin).name, Path(spec.origin)
        return
    for root in sorted(map(Path, spec.submodule_search_locations)):
        for path in sorted(root.rglob("*")):
            if path.name.endswith(_SOURCES) and path.is_file():
                yield path.relative_to(root).as_posix(), path
