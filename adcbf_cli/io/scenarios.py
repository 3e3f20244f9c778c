"""Scenario files: the user's own, and those that come with the package."""

from __future__ import annotations

import difflib
from pathlib import Path

from adcbf_cli.core.errors import UsageError
from adcbf_cli.scenarios import scenario_names, scenario_text

MAX_READ_CHARACTERS = 1_000_001
"""One more than a scenario may have: enough to tell that it is too long."""


def read_scenario(name_or_path: str) -> tuple[str, str]:
    """A scenario's text, and the stem of its name: of a file, if there is one, else of a packaged scenario.
    Raises UsageError where there is neither."""
    path = Path(name_or_path)
    names = scenario_names()
    if name_or_path in names and not path.is_file():
        return scenario_text(name_or_path), name_or_path
    try:
        with path.open(encoding="utf-8") as stream:
            return stream.read(MAX_READ_CHARACTERS), path.stem
    except FileNotFoundError as error:
        near = difflib.get_close_matches(path.stem, names, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise UsageError(
            f"{name_or_path}: no such scenario file, and none of those that come with it: {', '.join(names)}{hint}"
        ) from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{name_or_path}: not a text file; a scenario is YAML") from error
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UsageError(f"{name_or_path}: cannot be read: {reason}") from error
