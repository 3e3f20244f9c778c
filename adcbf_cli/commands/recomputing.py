"""Tells the user what a command is about to compute anew, why, and what goes with it."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from adcbf_cli.core.config import Config
from adcbf_cli.io.report import JSON_NAME, PAGE
from adcbf_cli.io.run_folder import DRIVING, STAGES, TABLES, Manifest, RunFolder
from adcbf_cli.io.run_settings import settings_made_with

_TOLD = (JSON_NAME, PAGE, *(f"{folder}/{JSON_NAME}" for folder in DRIVING.values()))
"""Of the reports that go, the ones that stand for the others beside them."""
_MOST = 3


def what_goes(
    folder: RunFolder, old: Manifest | None, new: Manifest, valid: Collection[str], todo: Collection[str], log: bool
) -> str | None:
    """One line, or None where nothing is lost that was there: results that this command does not make anew, or
    settings that fall back to the defaults.

    old, new: what the folder was made with, None where that is unintelligible, and what is in force now. valid: the
    stages that still hold; todo: those about to run. log: whether the command was given the log, not the folder.
    """
    if not RunFolder.is_one(folder.path):
        return None
    changes = [] if old is None else _changes(old.config, new.config)
    fallen_back = [name for name, _, now in changes if now == _of_tables(Config())[name]]
    gone = [stage for stage in STAGES if stage not in valid and stage not in todo]
    tables = [f"{name}.parquet" for stage in gone for name in TABLES[stage]]
    removed = [name for name in (*tables, *_TOLD) if (folder.path / name).exists()]
    if not removed and not (log and fallen_back):
        return None
    told = [f"{folder.path}: {' + '.join(todo)} computed anew ({_why(old, new, changes)})"]
    if removed:
        told.append(f"removed, being out of date: {', '.join(removed)}")
    if log and fallen_back:
        told.append(f"give {folder.path}, not the log, to keep its settings")
    return "; ".join(told)


def _why(old: Manifest | None, new: Manifest, changes: list[tuple[str, Any, Any]]) -> str:
    if old is None:
        return "made by another version"
    reasons = [f"{name} {_shown(before)} -> {_shown(now)}" for name, before, now in changes[:_MOST]]
    if len(changes) > _MOST:
        reasons.append(f"{len(changes) - _MOST} more settings")
    if old.source.sha256 != new.source.sha256:
        reasons.append("another log")
    if old.calibration != new.calibration:
        reasons.append("another calibration")
    return ", ".join(reasons) or "asked for, not whole, or made by another version"


def _changes(old: Config, new: Config) -> list[tuple[str, Any, Any]]:
    """The settings of the stages that differ: name, before, now."""
    before, now = _of_tables(old), _of_tables(new)
    return [(name, before[name], value) for name, value in now.items() if before[name] != value]


def _of_tables(config: Config) -> dict[str, Any]:
    return settings_made_with(config, None, {})["tables"]


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
