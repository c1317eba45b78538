#!/usr/bin/env python3
"""Checks recordings of visagged with tools that share no code with it.

    tools/check-recording.py RECORDING.mcap... [--stream BYTES] [--venv DIR]

PyPI mcap, mcap-ros2-support, rosbags and pymcap-cli are installed in DIR (a temporary folder unless given). All messages
of all topics must decode with mcap-ros2-support and with rosbags, `pymcap-cli doctor` must find nothing, not even to
remark, and the received bytes of /visagge/scip, joined, must be one stream without a gap: that of the file BYTES, where
given. Prints what was found; exit code 1 where anything is wrong.
"""

import argparse
import pathlib
import subprocess
import sys
import tempfile
import venv

PACKAGES = ["mcap", "mcap-ros2-support", "rosbags", "pymcap-cli"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", type=pathlib.Path)
    parser.add_argument("--stream", type=pathlib.Path, help="bytes that the device sent")
    parser.add_argument("--venv", type=pathlib.Path, help="folder for the packages, kept")
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.inside:
        sys.exit(check(arguments))
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.venv or pathlib.Path(temporary)
        python = folder / "bin" / "python"
        if not (folder / "bin" / "pymcap-cli").exists():
            venv.create(folder, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        sys.exit(subprocess.run([python, __file__, "--inside", *sys.argv[1:]]).returncode)


def check(arguments):
    received, failures = b"", []
    for path in arguments.recordings:
        counts, stream = decode(path, len(received), failures)
        received += stream
        print(f"{path}: {', '.join(f'{topic} {count}' for topic, count in sorted(counts.items()))}")
        read_with_rosbags(path, counts, failures)
        doctor(path, failures)
    print(f"{len(received)} bytes received")
    if arguments.stream and received != arguments.stream.read_bytes():
        failures.append(f"the joined bytes are not those of {arguments.stream}")
    for failure in failures:
        print(f"FAILED: {failure}")
    return 1 if failures else 0


def decode(path, offset, failures):
    """Number of messages of each topic, and the received bytes."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    counts, received = {}, b""
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in reader.iter_decoded_messages(log_time_order=False):
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            if (channel.message_encoding, schema.encoding) != ("cdr", "ros2msg"):
                failures.append(f"{path}: {channel.topic} is {channel.message_encoding}, {schema.encoding}")
            if channel.topic == "/visagge/scip" and content.direction == 0:
                if content.stream_offset != offset + len(received):
                    failures.append(f"{path}: stream_offset {content.stream_offset}, expected {offset + len(received)}")
                received += bytes(content.data)
            elif channel.topic == "/scan":
                beams = round((content.angle_max - content.angle_min) / content.angle_increment) + 1
                if beams != len(content.ranges):
                    failures.append(f"{path}: angles of /scan say {beams} beams, there are {len(content.ranges)}")
    return counts, received


def read_with_rosbags(path, counts, failures):
    """All messages again, by a decoder that has the types of ROS 2 from elsewhere and only ours from the file."""
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore, get_types_from_msg

    store = get_typestore(Stores.ROS2_HUMBLE)
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    for schema in summary.schemas.values():
        if schema.name not in store.fielddefs:
            own = schema.data.decode().split("=" * 80)[0]
            store.register(get_types_from_msg(own, schema.name))
    read = 0
    with AnyReader([path], default_typestore=store) as reader:
        for connection, _, data in reader.messages():
            store.deserialize_cdr(data, connection.msgtype)
            read += 1
    if read != sum(counts.values()):
        failures.append(f"{path}: rosbags read {read} messages of {sum(counts.values())}")


def doctor(path, failures):
    tool = pathlib.Path(sys.executable).parent / "pymcap-cli"
    result = subprocess.run([tool, "doctor", path], capture_output=True, text=True)
    print(result.stdout, result.stderr, sep="")
    # Where it has something to say it prints a table of what and where.
    if result.returncode != 0 or "Severity" in result.stdout:
        failures.append(f"{path}: pymcap-cli doctor, exit code {result.returncode}")


if __name__ == "__main__":
    main()
