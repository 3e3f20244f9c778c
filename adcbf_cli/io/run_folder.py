"""The run folder: fixed file names, a manifest (`run.json`), and the rule for what may be reused.

A stage's output is valid when every one of its tables is whole and carries the key that the
stage's input, configuration and code would give now, and the manifest lists the stage under the
same key. The manifest is written last, so a command killed at any moment leaves a stage either
valid or plainly not.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from pydantic import ValidationError

import adcbf_cli
from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.types import Loss
from adcbf_cli.io.atomic import remove_leftovers, write_text_atomically
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.parquet import SCHEMA_VERSION, table_metadata
from adcbf_cli.io.plugin_versions import stage_plugins
from adcbf_cli.io.report import remove_page
from adcbf_cli.io.settings import first_problem
from adcbf_cli.io.viz import VIEW_FILES

MANIFEST = "run.json"
LOCK = ".lock"

STAGES = ("cluster", "track", "predict")
"""In pipeline order; a stage needs all the earlier ones."""

TABLES: dict[str, tuple[str, ...]] = {
    "cluster": ("frames", "clusters"),
    "track": ("tracks",),
    "predict": ("predictions",),
}

OPTIONAL_TABLES: dict[str, tuple[str, ...]] = {"cluster": ("points",), "track": (), "predict": ()}
"""Tables that a setting asks for."""


DRIVING = {"plan": "open_loop", "replay": "replay"}
"""Where in a run folder each kind of driving keeps its tables and its report."""

DRIVING_FILES = (
    *(f"{name}.parquet" for name in ("drives", "trajectories", "plans", "plan_stages", "solve_times", "gamma")),
    "report.json",
    "report.md",
)


class OutdatedRunError(AdcbfError):
    """A run folder that another version of adcbf made, or whose settings were edited into something else."""


@dataclass(frozen=True)
class SourceFile:
    """One file of the log, for provenance."""

    name: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True)
class Source:
    """The log a run was made from: its path relative to the run folder, and the hash over its files."""

    path: str
    sha256: str
    files: tuple[SourceFile, ...]

    @property
    def name(self) -> str:
        """The log's own name, as text that can be shown and written."""
        return printable(Path(self.path).name)


@dataclass(frozen=True)
class StageRecord:
    """What the manifest says of a stage: its key, its tables' row counts, and its notes."""

    key: str
    rows: dict[str, int]
    warnings: list[str] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    counters: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Manifest:
    """`run.json`: what was run, on what, and how."""

    source: Source
    selection: dict[str, Any]
    config: Config
    stages: dict[str, StageRecord]
    calibration: str | None = None
    """The calibration file's text, where one was given: later commands on the folder use it again."""
    plugins: dict[str, str] = field(default_factory=dict)
    """By setting, the versions of other packages' plugins that took part."""

    def to_json(self) -> str:
        document = {
            "schema_version": SCHEMA_VERSION,
            "adcbf": adcbf_cli.__version__,
            "source": asdict(self.source),
            "selection": self.selection,
            "config": self.config.model_dump(mode="json"),
            "plugins": self.plugins,
            "calibration": self.calibration,
            "stages": {name: asdict(record) for name, record in self.stages.items()},
        }
        return json.dumps(document, indent=2, sort_keys=True) + "\n"

    @staticmethod
    def from_json(text: str) -> Manifest:
        document = json.loads(text)
        if not isinstance(document, dict):
            raise TypeError("it is no mapping")
        if document["schema_version"] != SCHEMA_VERSION:
            raise OutdatedRunError(f"schema version {document['schema_version']}, this adcbf reads {SCHEMA_VERSION}")
        source = document["source"]
        if not isinstance(document["selection"], dict) or not isinstance(source["path"], str):
            raise TypeError("its selection is no mapping, or its source has no path")
        if not isinstance(document.get("calibration"), str | None):
            raise TypeError("its calibration is no text")
        return Manifest(
            source=Source(source["path"], source["sha256"], tuple(SourceFile(**f) for f in source["files"])),
            selection=document["selection"],
            config=Config.model_validate(document["config"]),
            stages={
                name: StageRecord(**{**record, "losses": [Loss(**loss) for loss in record["losses"]]})
                for name, record in document["stages"].items()
            },
            calibration=document.get("calibration"),
            plugins=dict(document.get("plugins") or {}),
        )


class RunFolder:
    """One run's output folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @staticmethod
    def is_one(path: Path) -> bool:
        return (path / MANIFEST).is_file()

    def table(self, name: str) -> Path:
        return self.path / f"{name}.parquet"

    def driving_key(self, kind: str) -> str | None:
        """The key of the predictions that this kind of driving is of, or None where there is none (whole)."""
        folder = self.path / DRIVING[kind]
        found = [table_metadata(folder / name) for name in DRIVING_FILES if name.endswith(".parquet")]
        keys = {None if metadata is None else metadata.get("key") for metadata in found}
        return keys.pop() if len(keys) == 1 else None

    def remove_driving(self, kind: str) -> None:
        """Removes the files of one kind of driving, what a killed command left beside them, and the page, figures and
        logs for viewers that show them."""
        folder = self.path / DRIVING[kind]
        if folder.is_dir():
            remove_leftovers(folder)
            for name in DRIVING_FILES:
                (folder / name).unlink(missing_ok=True)
        for name in chain.from_iterable(VIEW_FILES.values()):
            (self.path / name).unlink(missing_ok=True)
        remove_page(self.path)

    def manifest(self) -> Manifest:
        """What the folder says of itself; AdcbfError if it says nothing intelligible."""
        path = self.path / MANIFEST
        try:
            return Manifest.from_json(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            raise UsageError(f"{self.path}: not a run folder (no {MANIFEST}); run a stage on a log first") from None
        except OutdatedRunError as error:
            raise OutdatedRunError(f"{path}: {error}; run on the log itself to make it anew") from None
        except ValidationError as error:
            reason = f"not this adcbf's settings ({first_problem(error)})"
            raise OutdatedRunError(f"{path}: {reason}; run on the log itself to make it anew") from None
        except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            reason = printable((str(error) or type(error).__name__).splitlines()[0])
            raise AdcbfError(f"{path}: unreadable ({reason}); remove the folder and run again") from None

    def usable_manifest(self) -> Manifest | None:
        """The manifest, None where there is none or another version's; AdcbfError for an unintelligible one."""
        if not RunFolder.is_one(self.path):
            return None
        try:
            return self.manifest()
        except OutdatedRunError:
            return None

    def write_manifest(self, manifest: Manifest) -> None:
        write_text_atomically(self.path / MANIFEST, manifest.to_json())

    def has_valid(self, stage: str, key: str) -> bool:
        """Whether this stage's tables are whole and were made under `key`."""
        manifest = self.usable_manifest()
        record = None if manifest is None else manifest.stages.get(stage)
        if record is None or record.key != key:
            return False
        return all((table_metadata(self.table(name)) or {}).get("key") == key for name in TABLES[stage])

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Creates the folder and holds it for writing; a second writer gets an error at once. The
        lock ends with the process, however it ends."""
        made = not self.path.exists()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise UsageError(f"{self.path}: is in the way, not a folder; choose another with -o") from None
        lock = self.path / LOCK
        with lock.open("w") as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise AdcbfError(f"{self.path}: another adcbf is writing here; wait, or choose another -o") from None
            remove_leftovers(self.path)
            try:
                yield
            finally:
                remove_leftovers(self.path)  # a stop while a file was being opened leaves it to the garbage collector
                if made and [*self.path.iterdir()] == [lock]:  # nothing came of it: no folder either
                    lock.unlink()
                    with suppress(OSError):
                        self.path.rmdir()


def stage_keys(source_sha256: str, config: Config, calibration: str | None) -> dict[str, str]:
    """Each stage's content key: everything its output depends on, hashed.

    calibration: the calibration file's text where prediction reads one.
    """
    parts: dict[str, list[Any]] = {
        "cluster": [source_sha256, config.read.model_dump(mode="json"), config.perception.model_dump(mode="json")],
        "track": [config.tracking.model_dump(mode="json")],
        "predict": [config.prediction.model_dump(mode="json"), calibration],
    }
    for setting, version in stage_plugins(config).items():
        parts["cluster" if setting.startswith("perception.") else "track"].append(version)
    keys: dict[str, str] = {}
    upstream = f"{SCHEMA_VERSION} {code_version()}"
    for stage in STAGES:
        text = json.dumps([upstream, stage, parts[stage]], sort_keys=True)
        upstream = keys[stage] = hashlib.sha256(text.encode()).hexdigest()
    return keys


@cache
def code_version() -> str:
    """The package's version and a hash of the sources that outputs depend on."""
    root = Path(adcbf_cli.__file__).parent
    digest = hashlib.sha256()
    for folder in ("core", "io"):
        for path in sorted((root / folder).rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return f"{adcbf_cli.__version__}+{digest.hexdigest()[:16]}"


def identify_source(path: str, files: tuple[Path, ...]) -> Source:
    """Hashes the log's files. A log of one file has that file's SHA-256, whatever it is called; of several files, or of
    scans, whose names say when they were taken, the hash is over names and contents. Where they lie does not count."""
    described = []
    for file in files:
        with file.open("rb") as handle:
            digest = hashlib.file_digest(handle, "sha256").hexdigest()
        described.append(SourceFile(printable(file.name), file.stat().st_size, digest))
    if len(files) == 1 and files[0].suffix.lower() != ".pcd":
        return Source(path, described[0].sha256, tuple(described))
    text = json.dumps([[f.name, f.sha256] for f in described])
    return Source(path, hashlib.sha256(text.encode()).hexdigest(), tuple(described))


def is_source(log: Path, source: Source) -> bool:
    """Whether what lies at this path is still the log `source`; False too where it is no log any more."""
    from adcbf_cli.io.logs import log_files

    try:
        return identify_source(source.path, log_files(log)).sha256 == source.sha256
    except (AdcbfError, OSError):
        return False
