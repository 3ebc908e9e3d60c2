"""How far does the viewer's page in a browser lag behind what is published?

    python benchmarks/viewer_lag.py [--seconds 60] [--vehicles 1] [--window 1600,1000]

A headless Chromium that draws in software opens the viewer's page. The vehicle rolls at a steady
3 degrees a second, so that the horizon in a picture tells when it was published, to some 0.3 s.
A lag is the time from then until the browser showed the picture, by its own
account: median and 95th percentile.
"""

import io
import os
import sys
import tempfile
import threading
import time
from itertools import count
from math import atan2, degrees, radians

import numpy as np
from common.report import MISSING, Row, parser, show
from PIL import Image

from drivers.events import VehicleId
from estimator.geometry.frames import from_euler_rad
from estimator.profile import load_profile
from estimator.types import Attitude, ImuSample
from fuzzbee.viewer.horizon import GROUND, SKY
from fuzzbee.viewer.stream import ViewerOptions
from fuzzbee.viewer.viewer import ViewerSink
from service.attitude_record import attitude_record
from service.records import Peer, Published
from tests.fuzzbee import browser

ROLL_DEG_S = 3.0
TURN_S = 360.0 / ROLL_DEG_S  # a longer lag than this would look short
SETTLE_S = 15.0  # the page loads and compiles
LEAST_PIXELS = 1000


def roll_deg(time_s: float) -> float:
    """The vehicle's roll at a time, within +-180."""
    return (ROLL_DEG_S * time_s + 180.0) % 360.0 - 180.0


def published(number: int, time_s: float, sequence: int) -> list[Published | Peer]:
    """What the service would publish at a time: an attitude, and two by others."""
    q = from_euler_rad(radians(roll_deg(time_s)), 0.0, 0.5)
    vehicle, time_us = VehicleId(number, 1), round(1e6 * time_s)
    attitude = Attitude(
        time_us=time_us,
        q_ned_frd=q,
        rate_rad_s=(radians(ROLL_DEG_S), 0.0, 0.0),
        gyro_bias_rad_s=(0.01, 0.0, 0.0),
        error=0.01,
        error_rate_1_s=0.1,
        gain=3.5,
        confidence_gravity=1.0,
        confidence_magnetic=1.0,
        sigma_inclination_rad=0.01,
        sigma_heading_rad=0.03,
        heading_reference="true",
    )
    record = attitude_record(
        attitude, time_unix_us=time_us, time_boot_us=time_us, sequence=sequence
    )
    sample = ImuSample(time_us, (0.0,) * 3, (0.0, 0.0, -9.8), (0.2, 0.0, 0.4), True)
    return [
        Peer(vehicle, "autopilot", q),
        Peer(vehicle, "sim", q),
        Published(vehicle, record, sample),
    ]


def publish(sink: ViewerSink, vehicles: int, rate_hz: float, stop: threading.Event) -> None:
    """Feed the sink in real time, as the service's own thread does."""
    begin_s = time.monotonic()
    for sequence in count():
        if stop.wait(max(0.0, begin_s + sequence / rate_hz - time.monotonic())):
            return
        now_s = time.time()
        for number in range(1, vehicles + 1):
            sink.handle(published(number, now_s, sequence))


def shown_roll_deg(picture: bytes) -> float | None:
    """The roll of the first horizon in a picture; None if there is none yet."""
    pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
    pixels = pixels[:, : int(0.6 * pixels.shape[1])]
    ground, sky = (np.abs(pixels - colour).max(axis=-1) < 24 for colour in (GROUND, SKY))
    rows, columns = np.nonzero(ground | sky)
    if len(rows) < LEAST_PIXELS or not ground.any() or not sky.any():
        return None
    middle = np.array([(columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2])
    reach = 0.48 * min(np.ptp(columns), np.ptp(rows))
    far = np.hypot(
        *np.meshgrid(np.arange(pixels.shape[1]) - middle[0], np.arange(pixels.shape[0]) - middle[1])
    )
    down = _centre(ground & (far < reach)) - _centre(sky & (far < reach))
    return degrees(atan2(down[0], down[1]))


def _centre(mask: np.ndarray) -> np.ndarray:
    rows, columns = np.nonzero(mask)
    return np.array([columns.mean(), rows.mean()]) if len(rows) else np.zeros(2)


def lag_s(shown_deg: float, now_s: float) -> float:
    """How old a roll is, modulo a whole turn."""
    age_s = (roll_deg(now_s) - shown_deg) / ROLL_DEG_S % TURN_S
    return age_s - TURN_S if age_s > TURN_S - 2.0 else age_s  # decoded to 0.3 s: it may look young


def measure(vehicles: int, rate_hz: float, seconds: float, settle_s: float, window: str) -> Row:
    """Lags of the page while the vehicles fly."""
    flags = [flag for flag in browser.FLAGS if not flag.startswith("--window-size")]
    browser.FLAGS = (*flags, f"--window-size={window}")
    sink = ViewerSink(ViewerOptions(view="web", live=True), load_profile("imu"))
    stop = threading.Event()
    flying = threading.Thread(target=publish, args=(sink, vehicles, rate_hz, stop))
    lags = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        flying.start()
        try:
            with browser.page(sink.stream.page, folder) as page:
                for _ in page.frames(settle_s):
                    pass
                for picture, at_s in page.frames(seconds):
                    shown = shown_roll_deg(picture)
                    if shown is not None:
                        lags.append(lag_s(shown, at_s))
        finally:
            stop.set()
            flying.join()
            sink.close()
    return {
        "vehicles": vehicles,
        "Hz": rate_hz,
        "window": window,
        "pictures/s": len(lags) / seconds,
        "lag s": np.percentile(lags, (50, 95)).tolist() if lags else None,
        "the last": lags[-1] if lags else None,
        "load average": round(os.getloadavg()[0], 1),
    }


def main() -> int:
    made = parser(__doc__)
    made.add_argument("--vehicles", type=int, default=1)
    made.add_argument("--rate", type=float, default=100.0, help="attitudes a second")
    made.add_argument("--seconds", type=float, default=60.0)
    made.add_argument("--window", default="1600,1000", help="width and height in pixels")
    options = made.parse_args()
    settle_s = SETTLE_S
    if options.smoke:
        options.seconds, settle_s, options.window = 3.0, 3.0, "600,400"
    if browser.program() is None:
        row = {"vehicles": options.vehicles, "window": f"Chromium: {MISSING}"}
    else:
        row = measure(options.vehicles, options.rate, options.seconds, settle_s, options.window)
    show({"the viewer's page behind what is published": [row]}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
