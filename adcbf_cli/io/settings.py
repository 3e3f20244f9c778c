"""Where the configuration comes from: defaults < file < environment < flags, later wins.

The environment's names are `ADCBF_TRACKING__GATE_PROBABILITY` for `tracking.gate_probability`.
Values are read as YAML scalars or lists. An unknown key is an error that names the nearest one.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import UsageError

ENVIRONMENT_PREFIX = "ADCBF_"

Nested = dict[str, dict[str, Any]]

_SELF_EXPLAINING = ("missing", "extra_forbidden", "unknown_name")
"""Findings whose text says already what was given."""


def settings_yaml(config: Config) -> str:
    """All settings as a file that `--config` takes."""
    text: str = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    return text


def resolve_config(
    base: Config,
    file: Path | None = None,
    settings: Iterable[str] = (),
    overrides: Mapping[str, Any] | None = None,
    environment: Mapping[str, str] | None = None,
) -> Config:
    """The configuration in force.

    base: the defaults, or what a run folder was made with. settings: `stage.key=value` texts from
    `--set`. overrides: values of dedicated flags by dotted key; None means "not given".
    """
    values = base.model_dump()
    if file is not None:
        _merge(values, _from_file(file), str(file))
    _merge(values, _from_environment(os.environ if environment is None else environment), "environment")
    _merge(values, _from_settings(settings), "--set")
    given = {key: value for key, value in (overrides or {}).items() if value is not None}
    _merge(values, _nest(given.items()), "flags")
    try:
        return Config.model_validate(values)
    except ValidationError as error:
        raise UsageError(first_problem(error)) from None


def known_keys(model: type[BaseModel] = Config) -> list[str]:
    """All dotted keys of a configuration model, in order."""
    keys = []
    for name, info in model.model_fields.items():
        inner = info.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            keys += [f"{name}.{key}" for key in known_keys(inner)]
        else:
            keys.append(name)
    return keys


def first_problem(error: ValidationError, prefix: str = "") -> str:
    """The first finding of a pydantic error as one line: where, what, and what it got."""
    finding = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in finding["loc"])
    named = f"{where}: " if where else ""  # without, it is the whole that is wrong
    got = "" if finding["type"] in _SELF_EXPLAINING else f" (got {finding['input']!r:.60})"
    return f"{prefix}{named}{finding['msg'][0].lower()}{finding['msg'][1:]}{got}"


def read_text(path: Path) -> str:
    """A file that the user names beside the log (settings, calibration), as text."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise UsageError(f"{path}: cannot be read ({reason})") from None


def nearest(word: str, words: Iterable[str]) -> str:
    """` did you mean X?`, or nothing where no word is close."""
    close = difflib.get_close_matches(word, list(words), n=1, cutoff=0.5)
    return f"; did you mean {close[0]}?" if close else ""


def _merge(values: dict[str, Any], more: Nested, origin: str) -> None:
    keys = known_keys()
    for stage, fields in more.items():
        for name, value in fields.items():
            if f"{stage}.{name}" not in keys:
                key = f"{stage}.{name}" if name else stage
                hint = nearest(key, keys) or "; `adcbf config dump` lists them all"
                raise UsageError(f"{origin}: unknown key {key}{hint}")
            values[stage][name] = value


def _from_file(path: Path) -> Nested:
    text = read_text(path)
    try:
        document = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: a number or date that is none
        raise UsageError(f"{path}: not valid YAML ({' '.join(str(error).split())})") from None
    if document is None:
        return {}
    if not isinstance(document, dict):
        raise UsageError(f"{path}: expected stages with keys below them, as `adcbf config dump` prints")
    for stage, fields in document.items():
        if not isinstance(fields, dict):
            hint = nearest(str(stage), Config.model_fields) if stage not in Config.model_fields else ""
            raise UsageError(f"{path}: {stage}: expected keys below it{hint}")
    return {str(stage): {str(k): v for k, v in fields.items()} for stage, fields in document.items()}


def _from_environment(environment: Mapping[str, str]) -> Nested:
    found = []
    for name, text in sorted(environment.items()):
        key = name.removeprefix(ENVIRONMENT_PREFIX)
        if key != name and "__" in key:
            found.append((key.lower().replace("__", ".", 1), _value(text, name)))
    return _nest(found)


def _from_settings(settings: Iterable[str]) -> Nested:
    found = []
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"--set {text}: expected stage.key=value, such as tracking.gate_probability=0.95")
        found.append((key.strip(), _value(value, f"--set {key}")))
    return _nest(found)


def _value(text: str, origin: str) -> Any:
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        raise UsageError(f"{origin}: {text[:80]!r} is not a YAML value") from None


def _nest(pairs: Iterable[tuple[str, Any]]) -> Nested:
    nested: Nested = {}
    for key, value in pairs:
        stage, _, name = key.partition(".")
        nested.setdefault(stage, {})[name] = value
    return nested
