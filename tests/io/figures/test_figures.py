"""The pictures: drawn from documents alone, the same bytes each time, every axis with its unit."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

from adcbf_cli.core.reproduction import fig3, fig4
from adcbf_cli.core.reproduction.circle import positions
from adcbf_cli.io.figures import style


def fig3_document() -> dict[str, Any]:
    now = np.arange(0.0, 60.0, 0.5)
    row = {
        "seed": 1,
        "tracked_s": now.tolist(),
        "tracked_m": (positions(now) + 0.01).tolist(),
        "predicted_s": (now + 3).tolist(),
        "predicted_m": (positions(now + 3) - 0.1).tolist(),
        "horizon_s": 3.0,
        "rmse_m": {"tracking": [0.01, 0.01], "step_30": [0.1, 0.1]},
    }
    return fig3.summarise([row])


def fig4_document() -> dict[str, Any]:
    return fig4.summarise([fig4.run(case) for case in fig4.CASES])


def fig2_document() -> dict[str, Any]:
    panel = {"outcomes": ["found", "merged", "merged", None], "label": [0, 0, 1, 1, -1], "merged": [1]}
    panel["circles_m"] = [[1.0, 1.0, 0.5], [4.0, 1.0, 1.0]]
    cells = [[1.0, 1.0], [1.2, 1.0], [4.0, 1.0], [4.5, 1.0], [7.0, 7.0]]
    panels = [{"name": name} | panel for name in ("dbscan", "hdbscan")]
    return {"drawn": {"seed": 1, "range_m": 8.0, "cells_m": cells, "panels": panels}}


DOCUMENTS = {"fig2": fig2_document, "fig3": fig3_document, "fig4": fig4_document}


@pytest.fixture(scope="module", params=DOCUMENTS)
def drawn(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    return request.param, DOCUMENTS[request.param]()


def test_the_same_document_gives_the_same_bytes(drawn: tuple[str, dict[str, Any]], tmp_path: Path):
    name, document = drawn
    one, two = tmp_path / "one", tmp_path / "two"
    for folder in (one, two):
        folder.mkdir()
        matplotlib.rcParams["font.size"] = 20 if folder is two else 10  # somebody's own settings
        style.write_figure(name, document, folder)
    matplotlib.rcdefaults()
    for kind in style.FORMATS:
        assert (one / f"{name}.{kind}").read_bytes() == (two / f"{name}.{kind}").read_bytes()


def test_files_are_pictures_without_a_date(drawn: tuple[str, dict[str, Any]], tmp_path: Path):
    name, document = drawn
    paths = style.write_figure(name, document, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in paths)
    assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    svg = (tmp_path / f"{name}.svg").read_text(encoding="utf-8")
    assert "<svg" in svg
    assert "dc:date" not in svg
    assert b"matplotlib" not in (tmp_path / f"{name}.png").read_bytes()


def test_axes_carry_units(drawn: tuple[str, dict[str, Any]]):
    name, document = drawn
    with style.styled():
        figure = importlib.import_module(f"adcbf_cli.io.figures.{name}").draw(document)
    labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert labels
    assert all(re.search(r"\[.+\]", label) for label in labels)


def test_fig3_shows_the_errors_below():
    document = fig3_document()
    with style.styled():
        figure = importlib.import_module("adcbf_cli.io.figures.fig3").draw(document)
    tracked, predicted = figure.axes[2].get_lines()
    np.testing.assert_allclose(tracked.get_ydata(), 0.01, atol=1e-4)
    np.testing.assert_allclose(predicted.get_ydata(), -0.1, atol=1e-4)


def test_fig2_marks_the_circle_that_merges():
    with style.styled():
        figure = importlib.import_module("adcbf_cli.io.figures.fig2").draw(fig2_document())
    assert figure.axes[0].get_title(loc="left") == "(a) dbscan: 1 found, 2 merged"
    assert [patch.get_linestyle() for patch in figure.axes[0].patches] == ["solid", "--"]
