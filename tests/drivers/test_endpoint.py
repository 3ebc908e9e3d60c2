"""Every spelling of an address, and the errors for wrong ones."""

import os

import pytest

from drivers.endpoint import FORMS, Endpoint, endpoint_help, parse_endpoint
from estimator.errors import InputError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sim:", Endpoint("sim")),
        ("sim:flight", Endpoint("sim", path="flight")),
        ("udpin:0.0.0.0:14550", Endpoint("udpin", "0.0.0.0", 14550)),
        ("udpin:14550", Endpoint("udpin", "127.0.0.1", 14550)),
        ("udpin::14550", Endpoint("udpin", "127.0.0.1", 14550)),
        ("udp://:14540", Endpoint("udpin", "127.0.0.1", 14540)),
        ("udp:10.0.0.1:14550", Endpoint("udpin", "10.0.0.1", 14550)),
        ("UDPIN:localhost:1", Endpoint("udpin", "localhost", 1)),
        ("udpout:vehicle.local:14550", Endpoint("udpout", "vehicle.local", 14550)),
        ("tcp:127.0.0.1:5760", Endpoint("tcp", "127.0.0.1", 5760)),
        ("tcpout://127.0.0.1:5760", Endpoint("tcp", "127.0.0.1", 5760)),
        ("tcpin:[::1]:5760", Endpoint("tcpin", "::1", 5760)),
        ("tcpin://:5760", Endpoint("tcpin", "127.0.0.1", 5760)),
        ("/dev/ttyUSB0:57600", Endpoint("serial", path="/dev/ttyUSB0", baud=57600)),
        ("/dev/ttyUSB0,921600", Endpoint("serial", path="/dev/ttyUSB0", baud=921600)),
        ("serial:///dev/ttyACM0:115200", Endpoint("serial", path="/dev/ttyACM0", baud=115200)),
        ("/dev/serial/by-id/usb-a:b:9600", Endpoint("serial", path="/dev/serial/by-id/usb-a:b",
                                                    baud=9600)),
        ("COM3:57600", Endpoint("serial", path="COM3", baud=57600)),
    ],
)  # fmt: skip
def test_spellings(text, expected):
    assert parse_endpoint(text) == expected
    assert parse_endpoint(str(expected)) == expected


@pytest.mark.parametrize(
    ("text", "output"),
    [
        ("", "empty"),
        ("udpin:127.0.0.1", "no port|port must be"),
        ("udpin:127.0.0.1:", "port must be"),
        ("udpin:127.0.0.1:99999", "99999"),
        ("udpin:127.0.0.1:0", "1 to 65535"),
        ("udpin:127.0.0.1:" + "9" * 5000, "port must be"),
        ("udpin:127.0.0.1:\u0663", "port must be"),
        ("/dev/ttyS0:" + "9" * 20, "no baud rate"),
        ("udpin:127.0.0.1:x", "'x'"),
        ("udpin:1.2.3.4/24:14550", "no host name"),
        ("udpin:a:b:1", "no host name"),
        ("udpout:14550", "no host"),
        ("tcp::5760", "no host"),
        ("/dev/ttyUSB0", "/dev/ttyUSB0:57600"),
        ("/dev/ttyUSB0:0", "no baud rate"),
        ("/dev/ttyS0:fast", "write it like /dev/ttyS0:57600"),
        ("serial:/dev/ttyUSB0", "no baud rate"),
        ("udpim:127.0.0.1:14550", "did you mean 'udpin:127.0.0.1:14550'"),
        ("tpc://1.2.3.4:5760", "did you mean 'tcp:"),
        ("sim", "did you mean 'sim:'"),
        ("14550", "did you mean 'udpin:127.0.0.1:14550'"),
        ("localhost:5760", "'tcp:localhost:5760'"),
        ("10.0.0.7:14550", "'udpout:10.0.0.7:14550'"),
        ("udpin", "write it like udpin:127.0.0.1:14550"),
        ("http://example.org:80", "unknown kind of source 'http'"),
        ("nowhere/flight.tlog", "no such file: 'nowhere/flight.tlog'"),
        ("x" * 5000, "no source|no such file"),
        ("a\0b", "no source|no such file"),
    ],
)
def test_bad_addresses_are_named(text, output):
    with pytest.raises(InputError, match=output) as caught:
        parse_endpoint(text)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
def test_files_are_logs_and_folders_and_pipes_are_not(tmp_path):
    log = tmp_path / "udpin:x"  # a file may have any name that is no address
    log.touch()
    assert parse_endpoint(str(log)) == Endpoint("log", path=str(log))
    os.mkfifo(tmp_path / "pipe")
    for path, words in ((tmp_path, "folder"), (tmp_path / "pipe", "no file but a pipe")):
        with pytest.raises(InputError, match=words):
            parse_endpoint(str(path))


@pytest.mark.skipif(os.name != "posix", reason="needs pseudo terminals")
def test_any_character_device_is_a_serial_device(tmp_path):
    link = tmp_path / "ttyV0"
    link.symlink_to("/dev/tty")
    assert parse_endpoint(f"{link}:9600") == Endpoint("serial", path=str(link), baud=9600)


def test_help_and_parser_share_the_table():
    text = endpoint_help()
    for form in FORMS:
        assert form.example in text
        if form.kind != "log":
            assert parse_endpoint(form.example).kind == form.kind
    assert "sim:" not in endpoint_help(("tcp",))
