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
    except (yaml.YAMLError, ValueError, RecursionError) as error:
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
    """'movers.2.path.speed_mps: must be > 0', and how many more there are."""
    details = error.errors(include_url=False, include_context=True)
    first = details[0]
    place = ".".join(str(part) for part in _path_in_file(first["loc"], data))
    if first["type"] == "extra_forbidden":
        message = _unknown_key(first["loc"])
    else:
        message = _plain_message(first["type"], first["msg"], first.get("ctx", {}))
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return f"{place}: {message}{more}" if place else f"{message}{more}"


def _path_in_file(loc: Sequence[int | str], data: Any) -> Iterator[int | str]:
    """The keys that lead to the error in the file: pydantic's path without the `kind` that it puts
    after a key whose value may be of several kinds."""
    for part in loc:
        if isinstance(data, dict) and part not in data and part == data.get("kind"):
            continue
        yield part
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            data = None


COMPARISONS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than": ("lt", "<"),
    "less_than_equal": ("le", "<="),
}


def _plain_message(kind: str, message: str, context: dict[str, Any]) -> str:
    """pydantic's message in the words of somebody who writes YAML."""
    if kind in COMPARISONS:
        name, sign = COMPARISONS[kind]
        return f"must be {sign} {context[name]:g}"
    if kind in ("too_long", "too_short"):
        bound, word = ("max_length", "most") if kind == "too_long" else ("min_length", "least")
        return f"must have at {word} {context[bound]} values, not {context['actual_length']}"
    known = {
        "missing": "is missing",
        "model_type": "must be a mapping of keys",
        "model_attributes_type": "must be a mapping of keys",
        "tuple_type": "must be a list",
        "union_tag_not_found": "needs a 'kind'",
        "invalid_key": "a key must be text",
    }
    if kind == "union_tag_invalid":
        return f"kind {context['tag']!r} is none of {context['expected_tags']}"
    return known.get(kind, message.removeprefix("Value error, ").replace("Input should", "should"))


def _unknown_key(loc: Sequence[int | str]) -> str:
    """What to say of an unknown key: the nearest one that its mapping does know."""
    near = difflib.get_close_matches(str(loc[-1]), sorted(_keys_at(loc[:-1])), n=1)
    return f"unknown key; did you mean {near[0]!r}?" if near else "unknown key"


def _keys_at(loc: Sequence[int | str]) -> set[str]:
    """The keys of the model that pydantic's path leads to."""
    models: list[type[BaseModel]] = [Scenario]
    for part in loc:
        fields = [model.model_fields[part] for model in models if part in model.model_fields]
        if fields:
            models = [inner for field in fields for inner in _models_in(field.annotation)]
        elif isinstance(part, str):
            models = [model for model in models if part in get_args(model.model_fields["kind"].annotation)]
    return {key for model in models for key in model.model_fields}


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models inside an annotation, such as those of a tuple of a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _models_in(inner)


def scenario_keys() -> set[str]:
    """Every key that a scenario may hold, at any level."""
    keys: set[str] = set()
    waiting: list[type[BaseModel]] = [Scenario]
    seen: set[type[BaseModel]] = set()
    while waiting:
        model = waiting.pop()
        if model not in seen:
            seen.add(model)
            keys.update(model.model_fields)
            waiting.extend(inner for field in model.model_fields.values() for inner in _models_in(field.annotation))
    return keys
