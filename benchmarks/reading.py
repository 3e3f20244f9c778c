"""Reading a log: adcbf's FrameReader beside the bare mcap reader and rosbags' AnyReader, in the same process.

    python benchmarks/reading.py LOG.mcap [--repeats 7] [--json FILE]

Each side opens the file and reads the same topics to the end, in turn, on one core. The bare mcap reader
only walks over the messages (decompressed, not decoded); AnyReader also deserialises them, and leaves a
cloud as bytes; FrameReader delivers float64 points without invalid ones, motion corrected where the log
holds point times, with the sensor's pose. Figures are medians over the repeats.
"""

from __future__ import annotations

import measuring  # isort: skip  (before numpy: one thread)
import argparse
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.types import Notes
from adcbf_cli.io.frame_reader import FrameReader


def bare_mcap(log: Path, topics: list[str]) -> int:
    """Messages walked over, undecoded."""
    with log.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages(topics=topics))


def any_reader(log: Path, topics: list[str]) -> int:
    """Messages deserialised."""
    count = 0
    with AnyReader([log]) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in topics]
        for connection, _, raw in reader.messages(wanted):
            reader.deserialize(raw, connection.msgtype)
            count += 1
    return count


def frame_reader(log: Path, _: list[str]) -> int:
    """Frames placed."""
    with FrameReader(log, ReadConfig(), Notes()) as reader:
        return sum(1 for _ in reader)


SIDES: dict[str, Callable[[Path, list[str]], int]] = {
    "mcap reader, undecoded": bare_mcap,
    "rosbags AnyReader, deserialised": any_reader,
    "adcbf FrameReader, placed points": frame_reader,
}


def measure(log: Path, repeats: int) -> dict[str, Any]:
    with FrameReader(log, ReadConfig(), Notes()) as reader:
        selection = reader.selection
    topics = [*selection.lidar, *([selection.pose] if selection.pose.startswith("/") else ["/tf"])]
    scans = frame_reader(log, topics)
    share = measuring.Share()
    spent: dict[str, list[float]] = {name: [] for name in SIDES}
    for _ in range(repeats):
        for name, read in SIDES.items():
            begin = perf_counter()
            read(log, topics)
            spent[name].append(1e3 * (perf_counter() - begin))
    return {
        "benchmark": "reading",
        "log": log.name,
        "topics": topics,
        "scans": scans,
        "megabytes": log.stat().st_size / 1e6,
        "repeats": repeats,
        "ms": {name: median(values) for name, values in spent.items()},
        "share_of_core": share(),
        "machine": measuring.machine(),
    }


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    own = result["ms"]["adcbf FrameReader, placed points"]
    rows = [
        [name, spent, spent / result["scans"], result["megabytes"] / (spent / 1e3), spent / own]
        for name, spent in result["ms"].items()
    ]
    title = f"`{result['log']}`, {result['scans']} scans, {result['megabytes']:.1f} MB, topics {result['topics']}:\n"
    head = ["reader", "ms, whole log", "ms a scan", "MB of file a second", "time / adcbf's"]
    return "\n".join([title, measuring.markdown(head, rows), measuring.busy_warning(result["share_of_core"])])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--repeats", type=int, default=7, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    measuring.pin_to_one_core()
    result = measure(arguments.log, arguments.repeats)
    print(table(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
