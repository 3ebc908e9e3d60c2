"""How long one ``Estimator.update`` takes in a loop at 1 kHz, and how long at worst.

    python benchmarks/loop.py --seconds 20

An IMU chip is simulated by its registers (16 bits, 2000 deg/s, 16 g, as MPU-9250 and its like have
them), and read as a driver on a Raspberry Pi would: 14 bytes every millisecond, the magnetometer's
six at 100 Hz. Microseconds by the clock: median, 99.9th percentile and the worst; the rest of the
millisecond the loop sleeps. The garbage collector is off in the loop, as ``run`` has it.
"""

import gc
import struct
import time

import numpy as np
from common.report import Row, parser, show

from drivers.simulation.simulated_vehicle import simulate
from fuzzbee import Estimator

PERIOD_S = 1e-3
GYR_LSB_RAD_S = np.radians(2000.0 / 32768)
ACC_LSB_M_S2 = 16 * 9.80665 / 32768
MAG_LSB_GAUSS = 0.0015
MAG_EVERY = 10  # samples


class Chip:
    """The registers of an IMU that lies still, with the noise of a small one."""

    def __init__(self, samples: int) -> None:
        made = simulate(0, samples, 1000.0, "rest", noise=0.05, bias=0.0)
        acc, gyr = made.acc_m_s2 / ACC_LSB_M_S2, made.gyr_rad_s / GYR_LSB_RAD_S
        words = np.column_stack((acc, np.zeros(samples), gyr)).round().astype(">i2")
        self._motion = [row.tobytes() for row in words]
        self._field = [
            row.tobytes() for row in (made.mag_gauss / MAG_LSB_GAUSS).round().astype("<i2")
        ]

    def read_motion(self, k: int) -> bytes:
        """ACCEL_XOUT_H and the 13 bytes behind it."""
        return self._motion[k]

    def read_field(self, k: int) -> bytes:
        """HXL and the 5 bytes behind it."""
        return self._field[k]


def loop(samples: int, *, has_mag: bool) -> np.ndarray:
    """Microseconds of each call of ``update``."""
    chip, estimator, took_us = Chip(samples), Estimator(), np.empty(samples)
    estimator.update((0.0, 0.0, 0.0), (0.0, 0.0, -9.8), time_s=-1.0)  # compiles, once
    begin_s = time.perf_counter()
    for k in range(samples):
        ax, ay, az, _, gx, gy, gz = struct.unpack(">7h", chip.read_motion(k))
        mag = None
        if has_mag and k % MAG_EVERY == 0:
            mag = [MAG_LSB_GAUSS * word for word in struct.unpack("<3h", chip.read_field(k))]
        gyr = (GYR_LSB_RAD_S * gx, GYR_LSB_RAD_S * gy, GYR_LSB_RAD_S * gz)
        acc = (ACC_LSB_M_S2 * ax, ACC_LSB_M_S2 * ay, ACC_LSB_M_S2 * az)
        called_s = time.perf_counter()
        estimator.update(gyr, acc, mag, time_s=PERIOD_S * k)
        took_us[k] = 1e6 * (time.perf_counter() - called_s)
        time.sleep(max(0.0, begin_s + PERIOD_S * (k + 1) - time.perf_counter()))
    return took_us


def main() -> None:
    """Print the table."""
    made = parser(__doc__)
    made.add_argument("--seconds", type=float, default=20.0)
    options = made.parse_args()
    samples = round((1.0 if options.smoke else options.seconds) / PERIOD_S)
    gc.disable()
    rows: list[Row] = []
    for name, has_mag in (("6D", False), ("9D", True)):
        took_us = loop(samples, has_mag=has_mag)
        median, rare, worst = np.percentile(took_us, (50.0, 99.9, 100.0)).round(1).tolist()
        rows.append({"update": name, "median us": median, "99.9 % us": rare, "worst us": worst})
    show({"one call at 1 kHz": rows}, as_json=options.json)


if __name__ == "__main__":
    main()
