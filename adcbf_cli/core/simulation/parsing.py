"""From a scenario's YAML text to its checked model, with errors that name the key."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.scenario import Scenario

MAX_SCENARIO_CHARACTERS = 1_000_000


def parse_scenario(text: str, source: str = "scenario") -> Scenario:
    """A scenario from YAML text. Raises UsageError naming the source and the first wrong key."""
    import yaml

    if len(text) > MAX_SCENARIO_CHARACTERS:
        raise UsageError(f"{source}: longer than {MAX_SCENARIO_CHARACTERS} characters, this is no scenario file")
    try:
        data = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or "cannot be parsed"
        raise UsageError(f"{source}{where}: not valid YAML: {problem}") from error
    if not isinstance(data, dict):
        raise UsageError(f"{source}: a scenario is a mapping with the keys duration_s, ego, lidar, ...")
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise UsageError(f"{source}: {_first_problem(error, data)}") from error


def _first_problem(error: ValidationError, data: Any) -> str:
    """'movers.2.path.speed_mps: must be > 0', without the tags that pydantic puts into a union's path."""
    details = error.errors(include_url=False, include_context=True)
    first = details[0]
    key = ".".join(str(part) for part in _path_in_file(first["loc"], data))
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    message = _plain_message(first["type"], first["msg"], first.get("ctx", {}))
    if first["type"] == "extra_forbidden":
        message = _unknown_key(str(first["loc"][-1]))
    return f"{key}: {message}{more}" if key else f"{message}{more}"


def _path_in_file(loc: Sequence[int | str], data: Any) -> Iterator[int | str]:
    for index, part in enumerate(loc):
        if isinstance(data, dict) and part not in data and part == data.get("kind") and index < len(loc) - 1:
            continue
        if isinstance(data, dict) and part not in data and index == len(loc) - 1 and part == data.get("kind"):
            return
        yield part
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            data = None


def _plain_message(kind: str, message: str, context: dict[str, Any]) -> str:
    comparisons = {"greater_than": ("gt", ">"), "greater_than_equal": ("ge", ">="), "less_than": ("lt", "<")}
    comparisons["less_than_equal"] = ("le", "<=")
    if kind in comparisons:
        name, sign = comparisons[kind]
        return f"must be {sign} {context[name]:g}"
    if kind == "missing":
        return "is missing"
    if kind == "union_tag_not_found":
        return "needs a 'kind'"
    if kind == "union_tag_invalid":
        return f"kind {context['tag']!r} is none of {context['expected_tags']}"
    return message.removeprefix("Value error, ").replace("Input should", "should")


def _unknown_key(key: str) -> str:
    near = difflib.get_close_matches(key, sorted(scenario_keys()), n=1)
    return f"unknown key; did you mean {near[0]!r}?" if near else "unknown key"


def scenario_keys() -> set[str]:
    """Every key that a scenario may hold, at any level."""
    keys: set[str] = set()
    waiting: list[Any] = [Scenario]
    seen: set[Any] = set()
    while waiting:
        kind = waiting.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            if kind not in seen:
                seen.add(kind)
                keys.update(kind.model_fields)
                waiting.extend(field.annotation for field in kind.model_fields.values())
        else:
            waiting.extend(get_args(kind))
    return keys
