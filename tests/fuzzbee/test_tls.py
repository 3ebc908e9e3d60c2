"""The example of docs/security.md, run as it stands there, with certificates made by its script."""

import json
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest
import zenoh

from tests.fuzzbee.processes import free_port, started
from tests.service.sessions import opened

EXAMPLE = Path(__file__).parents[2] / "docs" / "tls"

pytestmark = [
    pytest.mark.checkout,
    pytest.mark.skipif(not EXAMPLE.exists(), reason="needs the repository's docs"),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="needs openssl"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Certificates by the example's own commands."""
    made = tmp_path_factory.mktemp("tls")
    script = EXAMPLE / "certificates.sh"
    subprocess.run(["sh", "-e", str(script)], cwd=made, check=True, capture_output=True)
    return made


@pytest.fixture
def port():
    return free_port()


def configuration(folder, port, name):
    """A configuration of the example, with its files found and another port."""
    file = EXAMPLE / ("service.json5" if name == "service" else "tablet.json5")
    text = file.read_text("utf-8").replace(":7447", f":{port}").replace("tablet.", f"{name}.")
    text = re.sub(r'"(\w+\.(?:pem|key))"', lambda m: json.dumps(str(folder / m[1])), text)
    path = folder / f"{name}-{port}.json5"
    path.write_text(text)
    return path


def service(folder, port):
    config = configuration(folder, port, "service")
    return started("run", "sim:", "--rate", "20", "--json", "-c", str(config))


def client(folder, port, name):
    return opened(zenoh.Config.from_file(str(configuration(folder, port, name))))


def awaited(find, timeout_s=120.0):
    """What is found at last: a session learns of what it can ask only by and by."""
    end_s = time.monotonic() + timeout_s
    while not (found := find()) and time.monotonic() < end_s:
        time.sleep(0.05)
    return found


def first_attitude(session, timeout_s=120.0):
    seen = []
    subscriber = session.declare_subscriber("fuzzbee/*/attitude", seen.append)
    awaited(lambda: seen, timeout_s)
    subscriber.undeclare()
    return json.loads(seen[0].payload.to_string()) if seen else None


def answers(session, key, payload=None):
    replies = session.get(key, payload=payload, timeout=3.0)
    return [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]


def test_the_tablet_reads_and_the_office_changes(folder, port):
    change = json.dumps({"filter": {"gamma": 2.0}})
    with service(folder, port):
        with client(folder, port, "tablet") as tablet:
            assert first_attitude(tablet)["schema"] == 1
            assert awaited(lambda: answers(tablet, "fuzzbee/*/status"))
            assert answers(tablet, "fuzzbee/1/parameters", change) == []
        with client(folder, port, "office") as office:
            assert first_attitude(office)["schema"] == 1
            (profile,) = awaited(lambda: answers(office, "fuzzbee/1/parameters", change))
            assert json.loads(profile)["filter"]["gamma"] == 2.0


def test_without_a_certificate_nobody_gets_in(folder, port):
    with service(folder, port), client(folder, port, "tablet") as tablet:
        assert first_attitude(tablet) is not None
        config = zenoh.Config.from_file(str(configuration(folder, port, "nobody")))
        for key in ("connect_certificate", "connect_private_key"):
            config.insert_json5(f"transport/link/tls/{key}", "null")
        config.insert_json5("transport/link/tls/enable_mtls", "false")
        config.insert_json5("connect/timeout_ms", "3000")
        try:
            session = zenoh.open(config)
        except zenoh.ZError:
            return
        with session:  # TLS 1.3 lets the client believe so at first
            assert first_attitude(session, 3.0) is None
