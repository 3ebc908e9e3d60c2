"""What is reported of a link over which nothing comes, or nothing readable."""

import pytest

from drivers.endpoint import parse_endpoint
from drivers.mavlink.connection import LinkDiagnostics

SERIAL = parse_endpoint("/dev/ttyUSB0:57600")


@pytest.mark.parametrize(
    ("looks", "reported_s"),
    [([(100.0, False), (200.0, True), (204.9, True), (205.0, True), (300.0, True)], [205.0]),
     ([(0.0, True), (4.0, False), (6.0, True)], [])],
    ids=["once, five seconds after the link was opened", "not with data"],
)  # fmt: skip
def test_silence_is_reported(looks, reported_s):
    diagnostics = LinkDiagnostics(SERIAL)
    lines = {at_s: diagnostics.silence(at_s, is_silent=is_silent) for at_s, is_silent in looks}
    assert [at_s for at_s, line in lines.items() if line] == reported_s
    for at_s in reported_s:
        assert lines[at_s].startswith("/dev/ttyUSB0:57600: nothing has arrived in 5 s")


def test_bytes_without_a_frame_are_reported_once_and_again_after_a_frame():
    diagnostics = LinkDiagnostics(SERIAL)
    found = [diagnostics.bytes_read(100, 0, 0.5 * n) for n in range(12)]
    (text,) = [line for line in found if line]
    assert text.startswith("/dev/ttyUSB0:57600: 500 bytes and not one MAVLink frame: another baud")
    assert found.index(text) == 4
    assert diagnostics.bytes_read(100, 1, 7.0) is None
    assert any(diagnostics.bytes_read(300, 0, 8.0 + n) for n in range(5))
    few = LinkDiagnostics(SERIAL)
    assert not any(few.bytes_read(1, 0, n) for n in range(100))
