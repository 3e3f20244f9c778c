"""`adcbf reproduce`: the paper's tables and figures, computed anew beside the printed values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.options import Json
from adcbf_cli.core.reproduction import PARTS

if TYPE_CHECKING:
    from adcbf_cli.core.reproduction.part import Document, Part
    from adcbf_cli.io.reproduction_files import PartFiles

ALL = "all"
RUNS = "runs"
"""The folder, inside the output folder, of the finished runs' rows."""
README_TITLE = "# The paper, reproduced"


def reproduce(
    parts: Annotated[
        list[str],
        typer.Argument(
            metavar="PART...",
            help=f"{', '.join(PARTS)}, or all.",
            show_default=False,
            autocompletion=completing.one_of(*PARTS, "all"),
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Folder to write.")] = Path(
        "reproduction"
    ),
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, max=256, help="Processes at once.")] = 1,
    seeds: Annotated[
        str, typer.Option("--seeds", metavar="A:B|N,...", help="Seeds of the runs, B not included.")
    ] = "0:20",
    json_output: Json = False,
) -> None:
    """Compute the paper's tables and figures anew.

    Each part becomes FOLDER/PART.md and .json, the paper's value beside the one found here; a figure also .png and
    .svg. `all` joins the texts in FOLDER/README.md.

    Everything is made from the package alone: worlds are simulated, settings are the defaults. Finished runs
    are kept: the same command goes on where it was stopped, and leaves alone what is finished.

    Examples:

        adcbf reproduce table1

        adcbf reproduce all --jobs 2 --seeds 0:20 -o reproduction
    """
    from adcbf_cli.commands.options import parse_seeds
    from adcbf_cli.commands.terminal import print_json
    from adcbf_cli.core.errors import AdcbfError
    from adcbf_cli.core.reproduction import load_part
    from adcbf_cli.io.reproduction_files import check_folder
    from adcbf_cli.io.run_folder import RunFolder

    names, numbers = _chosen(parts), parse_seeds(seeds)
    check_folder(output)
    if ALL in parts:
        _check_readme(output)
    with RunFolder(output).locked():
        made = [_make(load_part(name), output, numbers, jobs) for name in names]
        if ALL in parts:
            _write_readme(output, made)
    if json_output:
        print_json({"folder": str(output), "parts": {one.part.name: _in_brief(one) for one in made}})
    else:
        print("\n".join(one.text for one in made), end="")
    failed = [one.part.name for one in made if one.failed]
    if failed:
        raise AdcbfError(f"some runs failed in {', '.join(failed)}; the same command tries them again")


@dataclass(frozen=True)
class _Made:
    """A part that is finished, but for `failed` runs of it."""

    part: Part
    document: Document
    text: str
    files: list[str]
    failed: int = 0


def _chosen(parts: Sequence[str]) -> list[str]:
    """The parts asked for, in their own order; UsageError for one that there is not."""
    from adcbf_cli.core.errors import UsageError
    from adcbf_cli.io.settings import nearest

    known = (*PARTS, ALL)
    for name in parts:
        if name not in known:
            hint = nearest(name.lower(), known)
            raise UsageError(f"there is no part {name!r}{hint}; there are {', '.join(known)}")
    return [name for name in PARTS if name in parts or ALL in parts]


def _make(part: Part, folder: Path, seeds: Sequence[int], jobs: int) -> _Made:
    """Runs what is missing of a part and writes its files, unless they are there already."""
    from adcbf_cli.commands.terminal import say
    from adcbf_cli.io.reproduction_files import PartFiles, content_key

    files = PartFiles(folder, part.name)
    tasks = part.tasks(seeds)
    runs_key = content_key(part.runs_of or part.name, dict(part.settings))
    key = content_key(part.name, runs_key, list(tasks))
    document = files.finished(key)
    if document is not None:
        say(f"{part.name}: finished already, in {folder}")
        return _Made(part, document, files.text(), _names(part))
    good, failed = _run(part, tasks, folder / RUNS, runs_key, jobs)
    document = part.summarise(good)
    text = _text(part, document, failed, len(tasks))
    _write(files, part, document, text, None if failed else key)
    say(f"{part.name}: written to {folder}")
    return _Made(part, document, text, _names(part), len(failed))


def _run(
    part: Part, tasks: Mapping[str, Any], folder: Path, key: str, jobs: int
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """The rows of the runs that succeeded, and why the others failed; AdcbfError if none succeeded."""
    from adcbf_cli.commands.campaign import ERROR, run_campaign
    from adcbf_cli.commands.terminal import say
    from adcbf_cli.core.errors import AdcbfError
    from adcbf_cli.io.run_rows import RunRows

    with RunRows(folder, part.runs_of or part.name, key) as rows:
        if rows.opened == "replaced":
            say(f"{part.name}: the kept runs are of other code or settings; running all again")
        found = run_campaign(tasks, part.run, rows, min(jobs, max(len(tasks), 1)), part.name)
    failed = {run_id: str(row[ERROR]) for run_id, row in zip(tasks, found, strict=True) if ERROR in row}
    good = [row for row in found if ERROR not in row]
    if not good:
        raise AdcbfError(f"{part.name}: every run failed, the first with: {next(iter(failed.values()))}")
    return good, failed


def _text(part: Part, document: Document, failed: Mapping[str, str], count: int) -> str:
    blocks = [f"# {part.title}"]
    if part.figure:
        blocks.append(f"![{part.title}]({part.name}.png)")
    blocks.append(part.markdown(document))
    if failed:
        first, why = next(iter(failed.items()))
        blocks.append(
            f"{len(failed)} of {count} runs failed and are not counted above, the first ({first}) with: {why}"
        )
    return "\n\n".join(blocks) + "\n"


def _write(files: PartFiles, part: Part, document: Document, text: str, key: str | None) -> None:
    from adcbf_cli.io.atomic import write_text_atomically

    files.forget()
    write_text_atomically(files.text_path, text)
    written = [files.text_path]
    if part.figure:
        from adcbf_cli.io.figures.style import write_figure

        written += write_figure(part.name, document, files.folder)
    files.finish(key, {"part": part.name, "title": part.title}, document, written)


def _names(part: Part) -> list[str]:
    return [f"{part.name}.{suffix}" for suffix in ("json", "md", *(("png", "svg") if part.figure else ()))]


def _check_readme(folder: Path) -> None:
    """UsageError where the page of all texts would take the place of somebody else's README."""
    from adcbf_cli.core.errors import UsageError

    page = folder / "README.md"
    if page.exists() and not page.read_bytes().startswith(README_TITLE.encode()):
        raise UsageError(f"{page}: is not of this command and would be overwritten; choose another folder with -o")


def _write_readme(folder: Path, made: Sequence[_Made]) -> None:
    """All parts' texts, one heading deeper, in one page."""
    from adcbf_cli.io.atomic import write_text_atomically

    head = (
        f"{README_TITLE}\n\n"
        "Written by `adcbf reproduce all`. Each section is a file of its own here, with its numbers in JSON beside it."
    )
    sections = [
        "\n".join(f"#{line}" if line.startswith("#") else line for line in one.text.split("\n")) for one in made
    ]
    write_text_atomically(folder / "README.md", "\n\n".join([head, *(section.strip() for section in sections)]) + "\n")


def _in_brief(made: _Made) -> dict[str, Any]:
    """A part for `--json`: without what only its picture needs."""
    document = {key: value for key, value in made.document.items() if key != "drawn"}
    return {"title": made.part.title, "files": made.files, "failed_runs": made.failed, "results": document}
