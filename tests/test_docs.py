"""The docs name what is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from adcbf_cli.io.schemas import SCHEMAS

PROJECT = Path(__file__).resolve().parent.parent
PAGES = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md"))]


@pytest.mark.parametrize("table", SCHEMAS)
def test_every_column_is_described(table: str) -> None:
    page = (PROJECT / "docs" / "tables.md").read_text()
    section = re.split(r"^### ", page, flags=re.M)
    text = next(part for part in section if part.startswith(f"{table}\n"))
    described = set(re.findall(r"`(\w+)`", text))
    assert set(SCHEMAS[table].names) <= described


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} links to {target}"
