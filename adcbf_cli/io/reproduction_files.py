"""The files of one part of the reproduction, and the rule for when they need not be made again.

`<part>.json` holds what was found, under the key of everything that it depends on, with the hashes of the
files beside it. It is written last: a part is finished when that key is today's and those files are whole.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import adcbf_cli
from adcbf_cli.core.errors import UsageError
from adcbf_cli.io.atomic import write_text_atomically
from adcbf_cli.io.run_folder import code_version

SCHEMA_VERSION = 1
Document = dict[str, Any]


def content_key(*parts: Any) -> str:
    """A hash of JSON values and of the code."""
    text = json.dumps([SCHEMA_VERSION, code_version(), *parts], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check_folder(path: Path) -> None:
    """Makes the folder where it is missing. UsageError where nothing can be written to it."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise UsageError(f"{path}: is in the way, not a folder; choose another with -o") from None
    except PermissionError:
        raise UsageError(f"{path}: may not be made here; choose another with -o") from None
    if not os.access(path, os.W_OK | os.X_OK):
        raise UsageError(f"{path}: may not be written to; choose another with -o")


class PartFiles:
    """One part's files in a folder."""

    def __init__(self, folder: Path, name: str) -> None:
        self.folder = folder
        self.json_path = folder / f"{name}.json"
        self.text_path = folder / f"{name}.md"

    def finished(self, key: str) -> Document | None:
        """What the finished part found, or None where it has to be made (again)."""
        try:
            stored = json.loads(self.json_path.read_text(encoding="utf-8"))
            whole = stored["key"] == key and all(
                _sha256(self.folder / name) == digest for name, digest in stored["files"].items()
            )
            document: Document = dict(stored["document"])
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return None  # absent, or not what this command writes: it is then written anew
        return document if whole else None

    def text(self) -> str:
        return self.text_path.read_text(encoding="utf-8")

    def forget(self) -> None:
        """What follows replaces the files: until it is through, the part is not finished."""
        self.json_path.unlink(missing_ok=True)

    def finish(self, key: str | None, about: Mapping[str, Any], document: Document, files: Iterable[Path]) -> None:
        """Writes the document. key: None where the part is to be made again next time."""
        stored = {
            "schema_version": SCHEMA_VERSION,
            "adcbf": adcbf_cli.__version__,
            **about,
            "key": key,
            "files": {path.name: _sha256(path) for path in files},
            "document": document,
        }
        write_text_atomically(self.json_path, json.dumps(stored, indent=1, allow_nan=False) + "\n")


def _sha256(path: Path) -> str:
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()
