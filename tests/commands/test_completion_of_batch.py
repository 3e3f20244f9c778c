"""What is offered behind the -- of `adcbf batch`: what the command offers that stands there."""

from __future__ import annotations

from pathlib import Path

import pytest

from adcbf_cli.commands.batch_work import COMMANDS
from adcbf_cli.commands.completing import behind_dashes
from tests.commands.test_completion import home, offers

__all__ = ["home"]


@pytest.mark.parametrize(
    ("line", "asked"),
    [
        ("adcbf batch a.mcap -j 2 -- cluster --li", "adcbf cluster a.mcap 2 --li"),
        ("adcbf batch 'x/*.mcap' -- --set read.", "adcbf run 'x/*.mcap' --set read."),
        ("adcbf batch a.mcap -- --li", "adcbf run a.mcap --li"),
        ("adcbf batch a.mcap -- plan ", "adcbf plan a.mcap "),
        ("adcbf batch a.mcap -- pla", None),
        ("adcbf batch a.mcap -- ", None),
        ("adcbf batch a.mcap -o ", None),
        ("adcbf run a.mcap -- --li", None),
        ("adcbf", None),
        ("", None),
        (" -- ", None),
    ],
)
def test_the_line_that_is_asked_instead(line: str, asked: str | None) -> None:
    assert behind_dashes(line) == (line if asked is None else asked)


def test_the_offers(home: Path) -> None:
    assert offers(home, "adcbf batch sample.mcap -- cluster --lidar ") == ["/points"]
    assert offers(home, "adcbf batch 'sam*.mcap' -- --lidar /p") == ["/points"]
    assert offers(home, "adcbf batch sample.mcap -- ") == list(COMMANDS)
    assert offers(home, "adcbf batch sample.mcap -- ev") == ["evaluate"]
    assert offers(home, "adcbf batch sample.mcap --engine ") == ["processes", "ray"]
    assert offers(home, "adcbf batch ") == [], "logs: the shell offers files"
