"""The site builds without a warning: no dead link, no page that nobody finds; and it says what the commands say."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer

from adcbf_cli.app import app

PROJECT = Path(__file__).resolve().parent.parent
DOCS = PROJECT / "docs"
PACKAGE = PROJECT / "examples" / "plugin_package"


def build(docs: Path, target: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(docs), str(target)]
    return subprocess.run(command, capture_output=True, text=True, cwd=PROJECT, check=False)


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("myst_parser", reason="the site's tools are not installed: pip install '.[dev]'")
    done = build(DOCS, tmp_path / "site")
    assert done.returncode == 0, done.stderr
    index = (tmp_path / "site" / "index.html").read_text()
    assert "quickstart.html" in index
    outside = [link for link in re.findall(r'(?:src|href)="(https?://[^"]+)"', index) if "pradyunsg" not in link]
    assert outside == [], "the site asks something of the network"


def test_a_dead_link_a_dead_heading_and_a_lost_page_fail_the_build(tmp_path: Path) -> None:
    pytest.importorskip("myst_parser", reason="the site's tools are not installed: pip install '.[dev]'")
    docs = tmp_path / "docs"
    docs.mkdir()
    shutil.copy(DOCS / "conf.py", docs)
    (docs / "index.md").write_text("# A\n\n[b](b.md) [c](c.md) [d](b.md#nothing)\n\n## Good\n\n[a](#good)\n")
    (docs / "b.md").write_text("# B\n")
    (docs / "lost.md").write_text("# Lost\n")
    done = build(docs, tmp_path / "site")
    assert done.returncode != 0
    assert "'c.md'" in done.stderr
    assert "'nothing'" in done.stderr
    assert "lost.md: WARNING: document isn't included in any toctree" in done.stderr
    assert "good" not in done.stderr


def command_pages() -> ModuleType:
    path = PROJECT / "scripts" / "command_pages.py"
    spec = importlib.util.spec_from_file_location("command_pages", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_commands_pages_say_what_help_says() -> None:
    wanted = command_pages().pages()
    found = {path.name: path.read_text() for path in (DOCS / "commands").glob("*.md")}
    stale = [name for name in {*wanted, *found} if wanted.get(name) != found.get(name)]
    assert stale == [], "run: make docs"


def commands(group: Any, path: str = "adcbf") -> dict[str, Any]:
    """Every command that does something, by how it is called."""
    found: dict[str, Any] = {}
    for name, command in group.commands.items():
        below = getattr(command, "commands", None)
        found |= commands(command, f"{path} {name}") if below else {f"{path} {name}": command}
    return found


COMMANDS = commands(typer.main.get_command(app))


@pytest.mark.parametrize("path", COMMANDS)
def test_every_command_has_examples_of_itself(path: str) -> None:
    examples = COMMANDS[path].help.partition("Example")[2]
    assert re.search(rf"^    .*{path}\b", examples, flags=re.M), f"{path} --help shows no example"


@pytest.mark.parametrize("path", COMMANDS)
def test_every_option_says_what_it_is(path: str) -> None:
    silent = [parameter.name for parameter in COMMANDS[path].params if not parameter.help and parameter.name != "help"]
    assert silent == []


def test_what_extending_shows_of_the_example_is_the_example() -> None:
    page = (DOCS / "extending.md").read_text()
    sources = [path.read_text() for path in [*PACKAGE.rglob("*.py"), PACKAGE / "pyproject.toml"]]
    shown = re.findall(r"```(?:python|toml)\n(.*?)```", page, flags=re.S)
    assert len(shown) >= 3
    for block in shown:
        assert any(block in source for source in sources), block
