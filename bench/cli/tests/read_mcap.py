"""Reads a flight log with the public readers, and compares every message with `ironbird export --format json`.

python read_mcap.py flight.mcap EXPORT_DIRECTORY

Prints as JSON: messages per channel, the schema and the metadata of each, the metadata records. A `/` in a name is a `.`.
"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


NO_TICK = 2**64 - 1


def plain(message):
    """A decoded message as dictionaries, lists and numbers, every field named; NaN is none, as JSON knows no such number."""
    fields = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            fields[field.name] = list(value) if field.is_repeated else None if value != value else value
        elif field.is_repeated:
            fields[field.name] = [plain(part) for part in value]
        else:
            fields[field.name] = plain(value)
    return fields


def flat(value):
    """The numbers of a message in the order of an export's columns: the envelope is last, and a tick that is none is null."""
    if isinstance(value, dict):
        envelope = [value["envelope"]] if "envelope" in value else []
        return flat([part for name, part in value.items() if name != "envelope"] + envelope)
    if isinstance(value, list):
        return [number for part in value for number in flat(part)]
    return [None if value == NO_TICK else value]


def main(log, exported):
    counts = {}
    lines = {path.stem: path.open() for path in Path(exported).glob("*.jsonl")}
    with open(log, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        channels = {
            channel.topic: {
                "schema": summary.schemas[channel.schema_id].name,
                "metadata": channel.metadata,
                "messages": summary.statistics.channel_message_counts.get(channel.id, 0),
            }
            for channel in summary.channels.values()
        }
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            topic = channel.topic
            counts[topic] = counts.get(topic, 0) + 1
            if topic in lines:
                expected = json.loads(lines[topic].readline())
                read = plain(decoded)
                # Floats of Python are doubles, and its JSON keeps them: equal here is equal in every bit but -0's.
                time_s, *numbers = expected.values()
                if flat(read) != numbers:
                    sys.exit(f"{topic}, message {counts[topic]}: read {read}, exported {expected}")
                times = (message.log_time, message.publish_time, message.sequence)
                tick = read["tick"] if "tick" in read else read["envelope"]["tick"]
                if abs(time_s - tick * 1e-3) > 1e-9:
                    sys.exit(f"{topic}: t_s = {time_s} of tick {tick}")
                if topic.endswith("_telemetry"):
                    # It belongs to the message right before it.
                    if (*times, read["tick"]) != before:
                        sys.exit(f"{topic}: not the times, number and tick of the message before it: {read}, {before}")
                else:
                    before = (*times, read["envelope"]["tick"])
                    sampled = read["envelope"]["sample_ns"]
                    if sampled and message.log_time != sampled:
                        sys.exit(f"{topic}: log time {message.log_time}, sampled {sampled}")
            if channel.metadata.get("telemetry") and "telemetry" in str(decoded):
                sys.exit(f"{topic}: what its law shows has a channel of its own, and is in {decoded}")
            if topic.startswith("pose/") and decoded.frame_id != "world":
                sys.exit(f"{topic}: its frame is {decoded.frame_id}")
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    for topic, rest in lines.items():
        if rest.readline():
            sys.exit(f"{topic}: more messages exported than read")
    for topic in channels:
        if channels[topic]["messages"] != counts.get(topic, 0):
            sys.exit(f"{topic}: {counts.get(topic, 0)} messages, its summary says {channels[topic]['messages']}")
    if records["settings"]["settings.toml"] != (Path(log).parent / "settings.toml").read_text():
        sys.exit("the log has other settings than settings.toml")
    channels = {topic.replace("/", "."): channel for topic, channel in channels.items()}
    json.dump({"channels": channels, "records": records}, sys.stdout)


if __name__ == "__main__":
    main(*sys.argv[1:])
