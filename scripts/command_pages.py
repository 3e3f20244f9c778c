"""Writes docs/commands/: one page a command, made of what its --help says, so that the two cannot differ.

    python scripts/command_pages.py           # write the pages
    python scripts/command_pages.py --check   # exit with 1, and name them, where pages are not as they would be written

`make docs` writes them; a test checks.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from adcbf_cli.app import app

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "commands"

GUIDES = {
    "batch": "batch.md",
    "cluster": "clustering.md",
    "compare": "compare.md",
    "evaluate": "metrics.md",
    "plan": "planning.md",
    "replay": "replay.md",
    "report": "report.md",
    "reproduce": "reproduction.md",
    "simulate": "closed-loop.md",
}
"""The page that explains what a command does, where there is one."""


def pages() -> dict[str, str]:
    """Each page's text by its file name."""
    root: Any = typer.main.get_command(app)
    found = {f"{name}.md": "\n".join(_page(f"adcbf {name}", command)) + "\n" for name, command in root.commands.items()}
    summaries = [f"| [{name}]({name}.md) | {_prose(_summary(command))} |" for name, command in root.commands.items()]
    paragraphs = [_prose(" ".join(part.split())) for part in (root.help or "").split("\n\n")]
    head = ["# Commands", "", "\n\n".join(paragraphs), "", "| command | what it does |", "| --- | --- |"]
    found["index.md"] = "\n".join([*head, *summaries]) + "\n"
    return found


def _page(path: str, command: Any, level: int = 1) -> Iterator[str]:
    """Name, what it does, how it is called, what it takes, examples; then the commands below it."""
    said, examples = _told(command)
    yield f"{'#' * level} {path}"
    yield from ("", said[0], "")
    yield from _fence([_usage(path, command)])
    for paragraph in said[1:]:
        yield from (paragraph, "")
    yield from _parameters(command)
    if examples:
        yield from (f"{'#' * (level + 1)} Examples", "")
        yield from _fence(examples)
    for name, below in getattr(command, "commands", {}).items():
        yield from _page(f"{path} {name}", below, level + 1)
    guide = GUIDES.get(path.split()[-1])
    if level == 1 and guide is not None and (FOLDER.parent / guide).exists():
        yield from (f"More on what it does: [{guide.removesuffix('.md')}](../{guide}).", "")


def _told(command: Any) -> tuple[list[str], list[str]]:
    """The help's paragraphs, and its examples, a line each: what is indented."""
    paragraphs, examples = [], []
    for paragraph in (command.help or "").split("\n\n"):
        if paragraph.startswith("    "):
            examples.append(" ".join(paragraph.split()))
        elif paragraph.strip() not in ("Example:", "Examples:"):
            paragraphs.append(_prose(" ".join(paragraph.split())))
    return paragraphs, examples


def _fence(lines: list[str]) -> Iterator[str]:
    if lines:
        yield from ("```sh", *lines, "```", "")


def _usage(path: str, command: Any) -> str:
    with command.make_context(path, [], resilient_parsing=True) as context:
        pieces = command.collect_usage_pieces(context)
    text = " ".join([path, *pieces])
    return text.translate(str.maketrans("", "", "{}")).replace("......", "...")  # braces: of some Typers only


def _parameters(command: Any) -> Iterator[str]:
    """Tables of arguments and options. Nothing that Typer words itself: that differs between its versions."""
    shown = [p for p in command.params if p.help and not getattr(p, "hidden", False)]
    for kind in ("argument", "option"):
        rows = [_row(parameter) for parameter in shown if parameter.param_type_name == kind]
        if rows:
            yield from (f"| {kind} | meaning |", "| --- | --- |", *rows, "")


def _row(parameter: Any) -> str:
    metavar = parameter.metavar or ("" if getattr(parameter, "is_flag", False) else parameter.name.upper())
    if parameter.param_type_name == "argument":
        name = metavar
    else:
        name = ", ".join(sorted(parameter.opts, key=len))
        name += "".join(f" / {other}" for other in parameter.secondary_opts)
        name = f"{name} {metavar}".strip()
    default = parameter.default
    known = parameter.show_default and isinstance(default, str | int | float | Path) and not isinstance(default, bool)
    return f"| `{_cell(name)}` | {_prose(_cell(parameter.help))}{f' Default: `{default}`.' if known else ''} |"


def _summary(command: Any) -> str:
    return " ".join((command.help or "").split("\n\n")[0].split())


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _prose(text: str) -> str:
    """Markdown that shows the text as it is: what looks like a tag would vanish, outside of code."""
    parts = text.split("`")
    parts[::2] = [part.replace("<", "\\<").replace("*", "\\*") for part in parts[::2]]
    return "`".join(parts)


def main(arguments: list[str]) -> int:
    wanted = pages()
    found = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.md")}
    stale = sorted(name for name in {*wanted, *found} if wanted.get(name) != found.get(name))
    if "--check" in arguments:
        for name in stale:
            print(f"docs/commands/{name} is not what --help says; run: make docs", file=sys.stderr)
        return 1 if stale else 0
    FOLDER.mkdir(exist_ok=True)
    for name in stale:
        if name in wanted:
            (FOLDER / name).write_text(wanted[name], encoding="utf-8")
        else:
            (FOLDER / name).unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
