"""Imports point downwards: commands -> io -> core's plain types; core knows nothing above it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import adcbf_cli

PACKAGE = Path(adcbf_cli.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

CORE_FOR_IO = ("types", "errors", "config", "frames")
"""What `io` may know of `core`."""


def imports_of(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names


@pytest.mark.parametrize("path", [p for p in MODULES if "core" in p.relative_to(PACKAGE).parts], ids=str)
def test_core_imports_nothing_above_it(path: Path) -> None:
    above = {name for name in imports_of(path) if name.startswith(("adcbf_cli.io", "adcbf_cli.commands"))}
    assert not above


@pytest.mark.parametrize("path", [p for p in MODULES if "io" in p.relative_to(PACKAGE).parts], ids=str)
def test_io_imports_no_commands(path: Path) -> None:
    assert not {name for name in imports_of(path) if name.startswith("adcbf_cli.commands")}


def test_help_loads_nothing_heavy() -> None:
    heavy = (
        "numpy", "scipy", "sklearn", "filterpy", "open3d", "pyarrow", "rosbags", "mcap", "pydantic", "pandas",
        "casadi", "numba", "piqp",
    )  # fmt: skip
    code = f"import sys, adcbf_cli.app; print([m for m in {heavy} if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "[]"
