"""Reads scans from a device with hokuyolx (PyPI), a driver written by others. Argument: HOST:PORT."""

import sys

import numpy as np
from hokuyolx import HokuyoLX

SCANS = 60


def main() -> None:
    host, port = sys.argv[1].rsplit(":", 1)
    # Its default activation, information and time synchronisation are all part of the test.
    laser = HokuyoLX(addr=(host, int(port)))
    assert laser.model.startswith("UTM-30LX"), laser.model
    assert (laser.amin, laser.amax, laser.aforw, laser.ares) == (0, 1080, 540, 1440)

    stamp, single = laser.get_dist()
    assert single.shape == (1081,), single.shape
    laser.activate()

    stamps = []
    for scan, stamp, pending in laser.iter_intens(scans=SCANS):
        assert scan.shape == (1081, 2), scan.shape
        distances = scan[:, 0]
        real = distances[distances >= laser.dmin]
        # The room is 6 m by 5 m: nearly every beam ends in it.
        assert len(real) > 900 and np.median(real) < 8000, (len(real), np.median(real))
        assert scan[:, 1].max() > 1000
        stamps.append(stamp)
    assert len(stamps) == SCANS and pending == 0
    steps = np.diff(np.array(stamps, dtype=np.int64))
    assert set(steps) == {25}, sorted(set(steps))

    window = [scan for scan, _, _ in laser.iter_dist(scans=3, start=180, end=900, grouping=3, skips=1)]
    assert [len(scan) for scan in window] == [241] * 3
    laser.standby()
    print(f"hokuyolx: {len(stamps)} scans of 1081 beams with intensity, stamps 25 ms apart; 3 clustered ones")


if __name__ == "__main__":
    main()
