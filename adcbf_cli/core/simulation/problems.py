"""What is wrong with a scenario, in one line that names the key: pydantic's errors in the words of
somebody who writes YAML."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from adcbf_cli.core.simulation.drawing import Place, dotted
from adcbf_cli.core.simulation.scenario import Scenario

RELATIVE_KINDS = ("crossing",)
"""Kinds of a mover's path that the file may hold and a drawn scenario does not."""


def first_problem(
    error: ValidationError,
    data: Any,
    model: type[BaseModel] = Scenario,
    place: Place = (),
    entries: Mapping[Place, Place] | None = None,
) -> str:
    """'movers.2.path.speed_mps: must be > 0', and how many more there are.

    data: what was validated as `model`, from this place in the file. entries: where in the file the
    entries of lists come from, by their own places.
    """
    details = error.errors(include_url=False, include_context=True)
    beside = [one for one in details if one["loc"][:-1] == details[0]["loc"][:-1]]
    unknown = [one for one in beside if one["type"] == "extra_forbidden"]
    first = unknown[0] if unknown and details[0]["type"] == "missing" else details[0]  # misspelt is missing, too
    keys = tuple(_path_in_file(first["loc"], data))
    entry = (entries or {}).get(keys[:2], keys[:2])
    where = dotted((*place, *entry, *keys[2:]))
    if first["type"] == "extra_forbidden":
        message = _unknown_key(first["loc"], model)
    else:
        message = _plain_message(first["type"], first["msg"], first.get("ctx", {}))
        if first["type"] == "union_tag_invalid" and keys[:1] == ("movers",) and keys[-1] == "path":
            message += "".join(f", {kind!r}" for kind in RELATIVE_KINDS)
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return f"{where}: {message}{more}" if where else f"{message}{more}"


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


def _unknown_key(loc: Sequence[int | str], model: type[BaseModel]) -> str:
    """What to say of an unknown key: the nearest one that its mapping does know."""
    near = difflib.get_close_matches(str(loc[-1]), sorted(_keys_at(loc[:-1], model)), n=1)
    return f"unknown key; did you mean {near[0]!r}?" if near else "unknown key"


def _keys_at(loc: Sequence[int | str], model: type[BaseModel]) -> set[str]:
    """The keys that the file may hold where pydantic's path from a model leads to."""
    models: list[type[BaseModel]] = [model]
    for part in loc:
        fields = [one.model_fields[part] for one in models if part in one.model_fields]
        if fields:
            models = [inner for field in fields for inner in models_in(field.annotation)]
        elif isinstance(part, str):
            models = [one for one in models if part in get_args(one.model_fields["kind"].annotation)]
    keys = {key for one in models for key in one.model_fields}
    return keys | {"beside_m"} if "at_m" in keys and loc[0] == "objects" else keys


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models inside an annotation, such as those of a tuple of a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from models_in(inner)
