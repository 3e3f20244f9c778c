"""The rows of finished runs, kept as they come: one JSON document a line, on disk before the next run counts.

`<name>.jsonl` begins with a header that names the key: everything that the rows depend on, hashed. Under
the same key the rows are kept and only the missing runs are left to do; under another they are no longer
true and the file is begun anew. A process killed at any moment loses at most the row it was writing.
"""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Literal

from adcbf_cli.core.errors import AdcbfError

SCHEMA_VERSION = 1
_HEADER_START = b'{"key": "'

Opened = Literal["new", "kept", "replaced"]
"""What opening found: no row, rows under the same key, or rows under another one, which are gone now."""


class RunRows:
    """The rows in `folder/name.jsonl`, held by this process until `close` or the `with` block's end.

    opened: what was found there. Raises AdcbfError where another process holds the file, or where it is no
    file of rows.
    """

    def __init__(self, folder: Path, name: str, key: str) -> None:
        self.path = folder / f"{name}.jsonl"
        self.key = key
        self.opened: Opened = "new"
        self._rows: dict[str, dict[str, Any]] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise AdcbfError(f"{folder}: is in the way, not a folder; choose another with -o") from None
        self._file: BinaryIO = open(self.path, "a+b")  # noqa: SIM115 - held as long as the object lives
        try:
            self._hold()
            self._load()
        except BaseException:
            self._file.close()
            raise

    @property
    def done(self) -> dict[str, dict[str, Any]]:
        """Each run's last row, by run id, in the order in which the runs were first added."""
        return self._rows

    def add(self, run_id: str, row: dict[str, Any]) -> dict[str, Any]:
        """Writes a run's row to the disk, instead of any that it had; returns it as it will be read again.

        ValueError for NaN or infinity (what is not known is null), TypeError for what JSON cannot hold.
        """
        line = json.dumps({"run": run_id, "row": row}, allow_nan=False)
        self._append(line)
        kept: dict[str, Any] = json.loads(line)["row"]
        self._rows[run_id] = kept
        return kept

    def close(self) -> None:
        """Gives the file back; rows read so far stay at hand."""
        self._file.close()

    def __enter__(self) -> RunRows:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _hold(self) -> None:
        """The lock is on the file itself and ends with the process, however it ends."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise AdcbfError(f"{self.path}: another adcbf is writing here; wait, or choose another -o") from None

    def _append(self, line: str) -> None:
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _load(self) -> None:
        self._file.seek(0)
        header, newline, rest = self._file.read().partition(b"\n")
        if newline:
            self.opened = "kept" if self._is_mine(header) else "replaced"
        elif not (header.startswith(_HEADER_START) or _HEADER_START.startswith(header)):
            raise self._foreign()  # but empty, or killed while writing the header, is as good as new
        if self.opened == "kept":
            self._file.truncate(len(header) + 1 + self._read(rest))
        else:
            self._begin()

    def _read(self, content: bytes) -> int:
        """Takes the whole rows; returns how many bytes they are. Only the last line can be torn."""
        lines = content.split(b"\n")[:-1]
        whole = 0
        for number, line in enumerate(lines, start=1):
            try:
                entry = json.loads(line)
                self._rows[entry["run"]] = dict(entry["row"])
            except (ValueError, LookupError, TypeError):
                if number == len(lines):
                    break
                where = f"{self.path}: line {number + 1}"
                raise AdcbfError(f"{where} is no run's row; remove the file to run all again") from None
            whole += len(line) + 1
        return whole

    def _is_mine(self, header: bytes) -> bool:
        """Whether the rows below this header were made under this key; AdcbfError if it is no header."""
        try:
            found = json.loads(header)
            key, version = found["key"], found["schema_version"]
        except (ValueError, LookupError, TypeError):
            raise self._foreign() from None
        return bool(key == self.key and version == SCHEMA_VERSION)

    def _begin(self) -> None:
        self._file.truncate(0)
        self._append(json.dumps({"key": self.key, "schema_version": SCHEMA_VERSION}))

    def _foreign(self) -> AdcbfError:
        return AdcbfError(f"{self.path}: is in the way, not a file of runs; move it, or choose another -o")
