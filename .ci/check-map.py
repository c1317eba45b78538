"""Whether a folder of results holds a map of something, and its files agree: check-map.py DIR"""

import json
import struct
import sys
import zlib
from pathlib import Path

folder = Path(sys.argv[1])
report = json.loads((folder / "report.json").read_text())
for name, wanted in report["files"].items():
    content = (folder / name).read_bytes()
    assert len(content) == wanted["bytes"], f"{name}: {len(content)} bytes, the report says {wanted['bytes']}"
    assert f"{zlib.crc32(content):08x}" == wanted["crc32"], f"{name}: not the file that the report belongs to"

summary = report["map"]
magic, size, depth, pixels = (folder / "map.pgm").read_bytes().split(b"\n", 3)
width, height = map(int, size.split())
assert (magic, depth) == (b"P5", b"255") and len(pixels) == width * height
assert (width, height) == (summary["width"], summary["height"])
free, occupied = pixels.count(254), pixels.count(0)
assert (free, occupied) == (summary["free"], summary["occupied"])
assert free > 1000, f"only {free} cells are free"
assert occupied > 100, f"only {occupied} cells are occupied"
assert summary["specular_like"] > 0, "no cell looks specular"

png = (folder / "map.png").read_bytes()
assert png.startswith(b"\x89PNG") and min(struct.unpack(">II", png[16:24])) > 100

lines = [line.split() for line in (folder / "trajectory.tum").read_text().splitlines()]
assert len(lines) == report["trajectory_poses"] and all(len(line) == 8 for line in lines)
assert report["finished"] and report["scans_inserted"] > 0
assert all(queue["dropped"] == 0 for queue in report["queues"].values()), report["queues"]
print(f"{folder}: {width} x {height} cells, {free} free, {occupied} occupied, {summary['specular_like']} specular-like")
