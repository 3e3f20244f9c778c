"""The beginning of the sample log, as a log of its own: most tests of commands need no more."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"


def write_short_log(path: Path, scans: int, skipped: int = 0) -> Path:
    """Writes `scans` scans of the sample log after the first `skipped`, with all else that was recorded until then."""
    with (SAMPLE / "sample.mcap").open("rb") as source, path.open("wb") as target:
        writer = Writer(target, chunk_size=100_000)
        writer.start("ros2")
        channels: dict[int, int] = {}
        seen = 0
        for schema, channel, message in make_reader(source).iter_messages():
            seen += channel.topic == "/points"
            if seen > skipped + scans:
                break
            if channel.topic == "/points" and seen <= skipped:
                continue
            if channel.id not in channels:
                assert schema is not None
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    return path
