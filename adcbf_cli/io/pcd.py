"""PCD point cloud files: ascii, binary and binary_compressed, as PCL writes them.

A parser of our own: open3d would take two seconds to load, and stops at files with bytes after the last point.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np

from adcbf_cli.core.errors import AdcbfError

_HEADER_BYTES = 16_384
_MAX_BYTES = 1 << 30
_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("I", 1): "i1", ("I", 2): "<i2", ("I", 4): "<i4", ("I", 8): "<i8"}
_TYPES |= {("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8"}


def read_pcd(path: Path) -> np.ndarray[Any, Any]:
    """Read a PCD file: its points as a structured array (n,), fields by name. Raises AdcbfError."""
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise AdcbfError(f"{path} cannot be read: {error.strerror}") from error
    if len(raw) > _MAX_BYTES:
        raise AdcbfError(f"{path} is larger than 1 GiB; no single scan is")
    try:
        return parse_pcd(raw)
    except ValueError as error:
        raise AdcbfError(f"{path} is not a readable PCD file: {error}") from error


def parse_pcd(raw: bytes) -> np.ndarray[Any, Any]:
    """Parse a PCD file's bytes; what follows the last point is ignored. Raises ValueError."""
    header, start = _header(raw)
    dtype, names = _dtype(header)
    points = _number(header, "POINTS", _number(header, "WIDTH", 0) * _number(header, "HEIGHT", 1))
    if points < 0 or points > _MAX_BYTES:
        raise ValueError(f"it claims {points} points")
    storage = header.get("DATA", ["ascii"])[0].lower()
    body = memoryview(raw)[start:]
    if storage == "ascii":
        rows = _ascii(body, dtype, points)
    elif storage == "binary":
        if points * dtype.itemsize > len(body):
            raise ValueError(f"{points} points need {points * dtype.itemsize} bytes, it has {len(body)}")
        rows = np.frombuffer(body, dtype=dtype, count=points)
    elif storage == "binary_compressed":
        rows = _compressed(body, dtype, names, points)
    else:
        raise ValueError(f"DATA {storage} is not known")
    return rows


def _header(raw: bytes) -> tuple[dict[str, list[str]], int]:
    """Header entries, and where the data starts."""
    end = re.compile(rb"^DATA[ \t]+\w+[ \t]*\r?\n", re.MULTILINE).search(raw, 0, _HEADER_BYTES)
    if end is None:
        raise ValueError("it has no DATA line")
    entries: dict[str, list[str]] = {}
    for line in raw[: end.end()].decode("ascii", "replace").splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            entries[words[0].upper()] = words[1:]
    return entries, end.end()


def _dtype(header: dict[str, list[str]]) -> tuple[np.dtype[Any], list[str]]:
    fields = header.get("FIELDS", header.get("COLUMNS", []))
    try:
        sizes = [int(word) for word in header.get("SIZE", [])]
        counts = [int(word) for word in header.get("COUNT", ["1"] * len(fields))]
    except ValueError as error:
        raise ValueError(f"its SIZE or COUNT is no number ({error})") from error
    types = [word.upper() for word in header.get("TYPE", [])]
    if not fields or not len(fields) == len(sizes) == len(types) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT do not match")
    names: list[str] = []
    formats: list[Any] = []
    for number, (field, size, kind, count) in enumerate(zip(fields, sizes, types, counts, strict=True)):
        if (kind, size) not in _TYPES or not 1 <= count <= 65_536:
            raise ValueError(f"field '{field}' has TYPE {kind}, SIZE {size}, COUNT {count}")
        names.append(field if field != "_" and field not in names else f"_padding{number}")
        formats.append(_TYPES[kind, size] if count == 1 else (_TYPES[kind, size], (count,)))
    if not {"x", "y", "z"} <= set(names):
        raise ValueError(f"it has no x, y and z; its fields are {', '.join(fields)}")
    return np.dtype({"names": names, "formats": formats}), names


def _number(header: dict[str, list[str]], key: str, otherwise: int) -> int:
    words = header.get(key)
    if not words:
        return otherwise
    try:
        return int(words[0])
    except ValueError as error:
        raise ValueError(f"its {key} is no number") from error


def _ascii(body: memoryview, dtype: np.dtype[Any], points: int) -> np.ndarray[Any, Any]:
    columns = sum(int(np.prod(dtype[name].shape, dtype=int)) for name in dtype.names or ())
    if points * columns * 2 > len(body) + 1:
        raise ValueError(f"{points} points do not fit into {len(body)} bytes of text")
    text = io.StringIO(bytes(body).decode("ascii", "replace"))
    if points == 0:
        return np.zeros(0, dtype=dtype)
    table = np.loadtxt(text, dtype=np.float64, max_rows=points, ndmin=2, comments=None)
    if table.shape != (points, columns):
        raise ValueError(f"it has {table.shape[0]} rows of {table.shape[1]} numbers instead of {points} of {columns}")
    rows = np.zeros(points, dtype=dtype)
    place = 0
    for name in dtype.names or ():
        width = int(np.prod(dtype[name].shape, dtype=int))
        chosen = table[:, place : place + width]
        with np.errstate(invalid="ignore"):
            rows[name] = chosen if dtype[name].shape else chosen[:, 0]
        place += width
    return rows


def _compressed(body: memoryview, dtype: np.dtype[Any], names: list[str], points: int) -> np.ndarray[Any, Any]:
    """binary_compressed: two uint32 sizes, then LZF data that holds one field after the other."""
    if len(body) < 8:
        raise ValueError("its compressed data is cut off")
    packed_bytes, unpacked_bytes = np.frombuffer(body[:8], dtype="<u4").tolist()
    if unpacked_bytes != points * dtype.itemsize or unpacked_bytes > _MAX_BYTES:
        raise ValueError(f"{points} points need {points * dtype.itemsize} bytes, it unpacks to {unpacked_bytes}")
    if packed_bytes > len(body) - 8:
        raise ValueError("its compressed data is cut off")
    data = lzf_decompress(bytes(body[8 : 8 + packed_bytes]), unpacked_bytes)
    rows = np.zeros(points, dtype=dtype)
    place = 0
    for name in names:
        base = dtype[name].base if dtype[name].subdtype else dtype[name]
        shape = (points, *dtype[name].shape)
        width = points * dtype[name].itemsize
        rows[name] = np.frombuffer(data, dtype=base, count=width // base.itemsize, offset=place).reshape(shape)
        place += width
    return rows


def lzf_decompress(packed: bytes, unpacked_bytes: int) -> bytes:
    """LZF (M. Lehmann's liblzf format): literal runs and back references. Raises ValueError.

    A control byte below 32 is followed by that many + 1 literals; else its upper three bits are the length - 2 (7: one
    more byte is added), its lower five and the next byte how far back to copy from, less one.
    """
    out = bytearray()
    position = 0
    end = len(packed)
    try:
        while position < end:
            control = packed[position]
            position += 1
            if control < 32:
                out += packed[position : position + control + 1]
                position += control + 1
            else:
                length = control >> 5
                if length == 7:
                    length += packed[position]
                    position += 1
                start = len(out) - ((control & 31) << 8) - packed[position] - 1
                position += 1
                length += 2
                if start < 0:
                    raise ValueError("its compressed data refers to before its beginning")
                piece = out[start : start + length]
                out += piece if len(piece) == length else (piece * (length // len(piece) + 1))[:length]
            if len(out) > unpacked_bytes:
                raise ValueError("its compressed data is longer than it says")
    except IndexError as error:
        raise ValueError("its compressed data is cut off") from error
    if len(out) != unpacked_bytes:
        raise ValueError(f"its compressed data unpacks to {len(out)} bytes instead of {unpacked_bytes}")
    return bytes(out)
