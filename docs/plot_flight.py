"""Plots a flight from its log: position, error, attitude, estimates, and how late every rotor command was.

Where the inner law estimates nothing, what it shows first stands in the estimates' place.

python docs/plot_flight.py runs/latest/flight.mcap [PICTURE]

Needs mcap, mcap-protobuf-support and matplotlib from PyPI.
"""

import argparse
from collections import defaultdict

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

# Signals of the law `adaptive`, and rows of the parameters' table that they are estimates of; the log lists both in the
# channels' metadata.
ESTIMATES = ("rotor_inertia_kg_m2", "rotational_drag_nm_s", "disturbance_gain_rad_s2")
MIXER = 3


def read(path):
    """Messages by topic, the metadata of each channel, and the records about the run."""
    messages = defaultdict(list)
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        channels = {channel.topic: channel.metadata for channel in reader.get_summary().channels.values()}
        topics = ["state", "setpoint", "wrench", "inner_telemetry", "rotor_speeds", "swaps"]
        for _, channel, _, message in reader.iter_decoded_messages(topics=topics):
            messages[channel.topic].append(message)
        records = {record.name: record.metadata for record in reader.iter_metadata()}
    return messages, channels, records


def plot(path, picture):
    messages, channels, records = read(path)
    period_s = int(records["run"]["sample_time_ns"]) * 1e-9

    def seconds(topic):
        return [message.envelope.tick * period_s for message in messages[topic]]

    states, setpoints, shown = messages["state"], messages["setpoint"], messages["inner_telemetry"]
    names = [entry.split(" [")[0] for entry in channels["state"]["unit.truth.parameter"].split(", ")]
    figure, axes = plt.subplots(4, 2, figsize=(12, 13), sharex=True, constrained_layout=True)

    for i, axis in enumerate("xyz"):
        line = axes[0, 0].plot(seconds("state"), [state.measured.position_w_m[i] for state in states], label=axis)[0]
        reference = [setpoint.reference.position_w_m[i] for setpoint in setpoints]
        axes[0, 0].plot(seconds("setpoint"), reference, "--", color=line.get_color(), linewidth=1)
    axes[0, 0].set_ylabel("position, reference dashed [m]")

    positions = {state.envelope.tick: state.measured.position_w_m for state in states}
    pairs = [(s, positions.get(s.envelope.input_tick[0])) for s in setpoints]
    errors = [
        (s.envelope.tick * period_s, sum((r - p) ** 2 for r, p in zip(s.reference.position_w_m, at)) ** 0.5)
        for s, at in pairs
        if at is not None
    ]
    axes[0, 1].plot(*zip(*errors))
    axes[0, 1].set_ylabel("position error [m]")

    for i, angle in enumerate(("roll", "pitch", "yaw")):
        axes[1, 0].plot(seconds("state"), [state.measured.attitude_rad[i] for state in states], label=angle)
    axes[1, 0].set_ylabel("attitude [rad]")

    for i in range(4):
        speeds = [state.measured.rotor_speed_mean_rad_s[i] for state in states]
        axes[1, 1].plot(seconds("state"), speeds, label=f"rotor {i + 1}", linewidth=0.8)
    axes[1, 1].set_ylabel("rotor speed [rad/s]")

    signals = [field.name for field in shown[0].DESCRIPTOR.fields if field.name != "tick"] if shown else []
    is_estimated = all(name in signals for name in ESTIMATES)
    for name, ax in zip(ESTIMATES if is_estimated else signals, (axes[2, 0], axes[2, 1], axes[3, 0])):
        times = [message.tick * period_s for message in shown]
        ax.plot(times, [getattr(message, name) for message in shown], label="estimate" if is_estimated else name)
        if is_estimated:
            truth = [state.truth.parameter[names.index(name)] for state in states]
            ax.plot(seconds("state"), truth, "--", label="true")
        ax.set_ylabel(f"{name} [{channels['inner_telemetry']['unit.' + name]}]")

    late = [
        (speeds.envelope.tick * period_s, (speeds.envelope.stamps[MIXER].send_ns - speeds.envelope.sample_ns) * 1e-3)
        for speeds in messages["rotor_speeds"]
        if speeds.envelope.sample_ns
    ]
    axes[3, 1].plot(*zip(*late), ".", markersize=1)
    axes[3, 1].set_yscale("log")
    axes[3, 1].set_ylabel("sample to rotor command [µs]")

    for ax in axes.flat:
        for swap in messages["swaps"]:
            ax.axvline(swap.envelope.tick * period_s, color="red", linewidth=1)
        ax.grid(alpha=0.3)
        if ax.get_yscale() == "linear":
            ax.ticklabel_format(axis="y", scilimits=(-3, 4))
        if ax.get_legend_handles_labels()[0]:
            ax.legend(loc="lower right", fontsize="small", ncols=2)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    figure.suptitle(f"run {records['run']['run_id']}, {records['landing']['ending']}; red: a parameter change")
    figure.savefig(picture, dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("log", help="a flight.mcap")
    parser.add_argument("picture", nargs="?", default="flight.png", help="where to write it [flight.png]")
    arguments = parser.parse_args()
    plot(arguments.log, arguments.picture)
    print(arguments.picture)
