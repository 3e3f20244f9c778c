"""From a scenario's YAML text to its checked model, with errors that name the key, and back."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ValidationError

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.drawing import KINDS
from adcbf_cli.core.simulation.placing import draw_scene
from adcbf_cli.core.simulation.problems import first_problem, models_in
from adcbf_cli.core.simulation.scenario import CrossingPath, Scenario

MAX_SCENARIO_CHARACTERS = 1_000_000


def parse_scenario(text: str, source: str = "scenario", seed: int | None = None) -> Scenario:
    """The scenario that YAML text describes, its random values drawn with a seed, which becomes the
    scenario's own; None takes the text's. Raises UsageError naming the source and the first wrong key."""
    data = _mapping(text, source)
    try:
        if seed is not None:
            data = {**data, "seed": seed}
        drawn = draw_scene(data)
        try:
            return Scenario.model_validate(drawn.data)
        except ValidationError as error:
            raise UsageError(first_problem(error, drawn.data, entries=drawn.entries)) from error
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from error


def scenario_yaml(scenario: Scenario) -> str:
    """The scenario as YAML with every value written out: parsed, it gives the same scenario again."""
    import yaml

    values = scenario.model_dump(mode="json", exclude_none=True)
    return str(yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=120))


def _mapping(text: str, source: str) -> dict[str, Any]:
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
    return data


def scenario_keys() -> set[str]:
    """Every key that a scenario file may hold, at any level."""
    keys: set[str] = {"beside_m", "repeat", "each", *KINDS}
    waiting: list[type[BaseModel]] = [Scenario, CrossingPath]
    seen: set[type[BaseModel]] = set()
    while waiting:
        model = waiting.pop()
        if model not in seen:
            seen.add(model)
            keys.update(model.model_fields)
            waiting.extend(inner for field in model.model_fields.values() for inner in models_in(field.annotation))
    return keys
