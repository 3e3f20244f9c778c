"""What goes to the terminal is what was given, whatever names users' files hold."""

from __future__ import annotations

import pytest

from adcbf_cli.commands.terminal import print_table


def test_names_that_look_like_markup_are_shown_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("drive[old].adcbf", ["class", "[red]n[/red]"], [["Pede[/b]strian", ":dog:"]])
    shown = capsys.readouterr().out
    for text in ("drive[old].adcbf", "[red]n[/red]", "Pede[/b]strian", ":dog:"):
        assert text in shown
