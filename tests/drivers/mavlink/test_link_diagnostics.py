"""What is told about a link over which nothing comes, or nothing readable."""

from drivers.endpoint import parse_endpoint
from drivers.mavlink.connection import LinkDiagnostics

SERIAL = parse_endpoint("/dev/ttyUSB0:57600")


def test_silence_is_told_once_five_seconds_after_the_link_was_opened():
    diagnostics = LinkDiagnostics(parse_endpoint("udpin:127.0.0.1:14550"))
    assert diagnostics.silence(100.0, is_silent=False) is None
    assert diagnostics.silence(200.0, is_silent=True) is None
    assert diagnostics.silence(204.9, is_silent=True) is None
    said = diagnostics.silence(205.0, is_silent=True)
    assert said.startswith("udpin:127.0.0.1:14550: nothing has arrived in 5 s")
    assert diagnostics.silence(300.0, is_silent=True) is None


def test_a_link_with_data_is_not_silent():
    diagnostics = LinkDiagnostics(SERIAL)
    assert diagnostics.silence(0.0, is_silent=True) is None
    assert diagnostics.silence(4.0, is_silent=False) is None
    assert diagnostics.silence(6.0, is_silent=False) is None


def test_bytes_without_a_frame_are_told_once_and_again_after_a_frame():
    diagnostics = LinkDiagnostics(SERIAL)
    said = [diagnostics.bytes_read(100, 0, 0.5 * n) for n in range(12)]
    (text,) = [line for line in said if line]
    assert text.startswith("/dev/ttyUSB0:57600: 500 bytes and not one MAVLink frame: another baud")
    assert said.index(text) == 4
    assert diagnostics.bytes_read(100, 1, 7.0) is None
    assert any(diagnostics.bytes_read(300, 0, 8.0 + n) for n in range(5))


def test_a_few_bytes_of_noise_say_nothing():
    diagnostics = LinkDiagnostics(SERIAL)
    assert not any(diagnostics.bytes_read(1, 0, n) for n in range(100))
