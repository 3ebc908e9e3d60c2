"""A recording that begins in mid-stream holds every frame from the port's opening on."""

import signal
import socket
import time

from drivers.events import VehicleId
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from tests.fuzzbee.processes import free_port, started

STAMP = 8  # bytes before each frame of a tlog
FRAMES = 300


def was_refused(sender):
    """Whether nobody had the port when the last datagram came: loopback shows it at once."""
    return sender.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) != 0


def test_every_frame_that_found_the_port_open_is_recorded(tmp_path):
    port, path = free_port(socket.SOCK_DGRAM), tmp_path / "flight.tlog"
    encoder, accepted = FrameEncoder(VehicleId(1, 1)), []
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        started("run", f"udpin:127.0.0.1:{port}", "--record", str(path), "--no-zenoh") as process,
    ):
        sender.connect(("127.0.0.1", port))
        while len(accepted) < FRAMES:
            assert process.poll() is None
            frame = encoder.frame(heartbeat(2, 3), 0)
            sender.send(frame)
            if not was_refused(sender):
                accepted.append(frame)
            time.sleep(0.01)  # below the limit of a sender without an IMU
        process.send_signal(signal.SIGTERM)
        process.wait(60)
    data, found = path.read_bytes(), []
    while data:
        end = STAMP + len(accepted[0])
        found.append(data[STAMP:end])
        data = data[end:]
    assert found == accepted
