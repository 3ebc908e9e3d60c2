"""The same job as a plain script: pymavlink reads, ahrs estimates, Zenoh publishes JSON.

``plain.py PORT ENDPOINT HZ`` is the live benchmark's comparison partner: one loop around
``recv_match``, Mahony's filter of ahrs for each vehicle, and at each tick one record a vehicle
under the keys of the service. It checks nothing, knows no health, and does not propagate the
attitude to the tick. It ends with SIGINT and prints a result like the service's.
"""

import json
import signal
import sys
import time
from typing import Any

import numpy as np
import zenoh
from ahrs.filters import Mahony
from pymavlink import mavutil

G_M_S2 = 9.80665
FLU_FRD = np.array([1.0, -1.0, -1.0])


class Vehicle:
    """One vehicle's filter and its latest attitude."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self.samples, self._sequence, self._publisher = 0, 0, publisher
        self._filter, self._q_enu_flu = Mahony(k_P=0.3, k_I=1e-6), np.array([1.0, 0.0, 0.0, 0.0])
        self._gyr_rad_s, self._time_us, self._arrival_us = np.zeros(3), 0, 0

    def update(self, m: Any) -> None:
        """Take a RAW_IMU."""
        gyr = np.array([m.xgyro, m.ygyro, m.zgyro]) * 1e-3
        acc = np.array([m.xacc, m.yacc, m.zacc]) * (1e-3 * G_M_S2)
        mag = np.array([m.xmag, m.ymag, m.zmag]) * 1e-3
        if self.samples:
            readings = (gyr * FLU_FRD, acc * FLU_FRD, mag * FLU_FRD)
            dt_s = 1e-6 * (m.time_usec - self._time_us)
            self._q_enu_flu = self._filter.updateMARG(self._q_enu_flu, *readings, dt_s)
        self._gyr_rad_s, self._time_us = gyr, m.time_usec
        self._arrival_us = time.time_ns() // 1000
        self.samples += 1

    def publish(self, now_us: int) -> None:
        """Put the latest attitude."""
        record = {
            "time_unix_us": now_us,
            "time_boot_us": self._time_us,
            "q_enu_flu": self._q_enu_flu.tolist(),
            "rate_rad_s": (self._gyr_rad_s - self._filter.b).tolist(),
            "age_ms": (now_us - self._arrival_us) / 1e3,
            "sequence": self._sequence,
        }
        self._publisher.put(json.dumps(record))
        self._sequence += 1


def main() -> None:
    port, endpoint, rate_hz = sys.argv[1:]
    stopped: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _frame: stopped.append(number))
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", dialect="ardupilotmega")
    vehicles: dict[int, Vehicle] = {}
    period_s, overruns = 1.0 / float(rate_hz), 0
    with zenoh.open(config) as session:
        print("listening", file=sys.stderr, flush=True)
        due_s = time.monotonic() + period_s
        while not stopped:
            left_s = due_s - time.monotonic()
            if left_s <= 0:
                now_us = time.time_ns() // 1000
                for vehicle in vehicles.values():
                    vehicle.publish(now_us)
                missed = int(-left_s / period_s)
                overruns += missed
                due_s += (missed + 1) * period_s
            elif message := link.recv_match(type="RAW_IMU", blocking=True, timeout=left_s):
                system = message.get_srcSystem()
                if system not in vehicles:
                    vehicles[system] = Vehicle(
                        session.declare_publisher(
                            f"fuzzbee/{system}/attitude",
                            congestion_control=zenoh.CongestionControl.DROP,
                        )
                    )
                vehicles[system].update(message)
    counts = {name: {"samples": each.samples, "rejected": {}} for name, each in vehicles.items()}
    print(json.dumps({"vehicles": counts, "overruns": overruns, "dropped": 0}))


if __name__ == "__main__":
    main()
