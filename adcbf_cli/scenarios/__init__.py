"""The scenarios that come with the package: YAML files beside this one, by the stems of their names."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


def scenario_names() -> list[str]:
    """All of them, sorted."""
    return sorted(
        Path(entry.name).stem for entry in resources.files(__name__).iterdir() if entry.name.endswith(".yaml")
    )


def scenario_text(name: str) -> str:
    """One's YAML; FileNotFoundError for a name that is none of `scenario_names`."""
    return (resources.files(__name__) / f"{name}.yaml").read_text(encoding="utf-8")
