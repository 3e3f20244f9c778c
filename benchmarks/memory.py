"""Peak memory and wall time of `adcbf run` on a log, and on the same log several times over.

    python benchmarks/memory.py LOG.mcap [--times 5] [--range 20] [--json FILE]

The longer log is written to a temporary folder: the same messages again and again, each round with its
stamps (the file's, the headers', the transforms') moved on by the log's length and a pause. Peak memory is
the largest resident set that the system counted for the command's own process. The machine's speed does
not enter it; it must not grow with the log.
"""

from __future__ import annotations

import measuring  # isort: skip
import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

PAUSE_NS = 2_000_000_000
"""Between rounds: longer than a track coasts, and than poses are interpolated over."""


def repeat_log(source: Path, target: Path, times: int) -> int:
    """Writes `source` (ROS 2 messages) `times` times over into `target`, stamps increasing; returns the
    number of messages written."""
    with source.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    if summary is None or summary.statistics is None:
        sys.exit(f"benchmarks/memory.py: {source} has no index to copy from")
    length_ns = summary.statistics.message_end_time - summary.statistics.message_start_time + PAUSE_NS
    shift = stamp_shifter(list(summary.schemas.values()))
    written = 0
    with target.open("wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="")
        channels = register(writer, summary.schemas, list(summary.channels.values()))
        for by_ns in range(0, times * length_ns, length_ns):
            for msgtype, message in messages(source):
                writer.add_message(
                    channel_id=channels[message.channel_id],
                    log_time=message.log_time + by_ns,
                    publish_time=message.publish_time + by_ns,
                    data=shift(message.data, msgtype, by_ns),
                    sequence=message.sequence,
                )
                written += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return written


def messages(log: Path) -> Iterator[tuple[str, Message]]:
    """Every message with its type."""
    with log.open("rb") as stream:
        for schema, _, message in make_reader(stream).iter_messages():
            assert schema is not None
            yield schema.name, message


def register(writer: Writer, schemas: dict[int, Schema], channels: list[Channel]) -> dict[int, int]:
    """The source's channels in the new file, by the id that each had."""
    known = {key: writer.register_schema(item.name, item.encoding, item.data) for key, item in schemas.items()}
    return {
        item.id: writer.register_channel(item.topic, item.message_encoding, known[item.schema_id], item.metadata)
        for item in channels
    }


def stamp_shifter(schemas: list[Schema]) -> Callable[[bytes, str, int], bytes]:
    """A function that moves every stamp inside a serialised message on by nanoseconds."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_typestore(Stores.ROS2_HUMBLE).fielddefs)
    for schema in schemas:
        missing = get_types_from_msg(schema.data.decode(), schema.name)
        store.register({name: found for name, found in missing.items() if name not in store.fielddefs})

    def shift(data: bytes, msgtype: str, by_ns: int) -> bytes:
        if by_ns == 0:
            return data
        return bytes(store.serialize_cdr(moved(store.deserialize_cdr(data, msgtype), by_ns), msgtype))

    return shift


def moved(value: Any, by_ns: int) -> Any:
    """The same message, its stamps (fields sec and nanosec) moved on."""
    if isinstance(value, list):
        return [moved(item, by_ns) for item in value]
    if not is_dataclass(value):
        return value
    kind: Any = type(value)
    names = [item.name for item in fields(kind) if item.name != "__msgtype__"]
    if names == ["sec", "nanosec"]:
        stamp: Any = value
        return kind(*divmod(stamp.sec * 1_000_000_000 + stamp.nanosec + by_ns, 1_000_000_000))
    return kind(**{name: moved(getattr(value, name), by_ns) for name in names})


def measured_run(log: Path, folder: Path, range_m: float) -> dict[str, float]:
    """Peak MB and wall seconds of one `adcbf run`. Raises CalledProcessError when it fails."""
    command = [sys.executable, "-m", "adcbf_cli", "run", str(log), "--range", f"{range_m:g}", "-o", str(folder)]
    begin = perf_counter()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        said = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command, stderr=said)
    unit = 1 if sys.platform == "darwin" else 1024
    return {"peak_mb": usage.ru_maxrss * unit / 1e6, "wall_s": perf_counter() - begin}


def measure(log: Path, times: int, range_m: float) -> dict[str, Any]:
    runs: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        longer = folder / "longer.mcap"
        runs["1"] = measured_run(log, folder / "once.adcbf", range_m)
        repeat_log(log, longer, times)
        runs[str(times)] = measured_run(longer, folder / "longer.adcbf", range_m)
    return {
        "benchmark": "memory",
        "log": log.name,
        "range_m": range_m,
        "runs": runs,
        "machine": measuring.machine(),
    }


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    rows = [[f"{times} x `{result['log']}`", run["peak_mb"], run["wall_s"]] for times, run in result["runs"].items()]
    head = [f"`adcbf run --range {result['range_m']:g}`", "peak MB", "wall s"]
    return measuring.markdown(head, rows) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--times", type=int, default=5, metavar="N")
    parser.add_argument("--range", type=float, default=20.0, metavar="M", dest="range_m")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    measuring.pin_to_one_core()
    result = measure(arguments.log, arguments.times, arguments.range_m)
    print(table(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
