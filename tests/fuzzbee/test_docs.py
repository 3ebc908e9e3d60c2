"""The documents' examples are run, their tables compared with what is published."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest
import zenoh

from estimator.geometry.metrics import batch_angle_errors
from estimator.reasons import Reason
from fuzzbee.cli import main
from fuzzbee.verdict import HEADING_DEG, HORIZON_DEG, WORDS
from service.records import AttitudeRecord, StatusRecord
from tests.fuzzbee.processes import begun, default_session, free_port, started
from tests.fuzzbee.recording import FLIPS, recorded
from tests.fuzzbee.services import await_line
from tests.programs import run_python
from tests.service.sessions import heard, opened, wait_for

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE = DOCS / "tls"

pytestmark = pytest.mark.checkout


PAGES = [page for page in (*sorted(DOCS.glob("*.md")), DOCS.parent / "README.md") if page.exists()]


def read(name):
    return (DOCS / name).read_text("utf-8")


def blocks(language, text):
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def section(name, title):
    return read(name).split(f"\n## {title}\n")[1].split("\n## ")[0]


@pytest.mark.parametrize("record", [AttitudeRecord, StatusRecord])
def test_every_published_field_is_documented(record):
    table = section("zenoh.md", record.__name__.removesuffix("Record"))
    documented = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    assert documented == [field.encode_name for field in msgspec.structs.fields(record)]


@pytest.mark.parametrize("name", ["design.md", "paper.md", "../CONTRIBUTING.md"])
def test_every_file_that_is_named_is_there(name):
    """In backticks, with a folder: paths from the repository's root, maybe with a name inside."""
    paths = re.findall(r"`([\w.]+/[\w./]+?\.(?:py|toml|md)|[\w.]+/[\w/]*/)(?:: \w+)?`", read(name))
    assert paths
    missing = [path for path in paths if not (DOCS.parent / path).exists()]
    assert missing == [path for path in missing if "NAME" in path]


def test_the_zenoh_examples_work_as_they_stand():
    """Only the port is another, so that tests do not meet."""
    port = free_port()
    examples = blocks("python", read("zenoh.md").replace("127.0.0.1:7447", f"127.0.0.1:{port}"))
    subscriber, replacement = examples
    assert len([line for line in subscriber.splitlines() if line]) <= 10
    with started("run", "--json", *default_session(port)) as service:
        await_line(service, "running")
        with begun(sys.executable, "-u", "-c", subscriber, stderr=None) as process:
            lines = [process.stdout.readline() for _ in range(5)]
            process.kill()
        profile = json.loads(run_python("-c", replacement, timeout_s=120).stdout)
    for line in lines:
        assert re.fullmatch(r"fuzzbee/1/attitude running \[(-?[\d.e-]+(, )?){3}\]\n", line)
    assert (profile["filter"]["gamma"], profile["confidence"]["magnetic"]) == (0.5, 0.2)


def command_lines():
    """(page, arguments) of every line in a shell block that calls us."""
    for page in PAGES:
        for block in blocks("sh", page.read_text("utf-8")):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line.split(" > ")[0], comments=True)
                if words[:1] == ["fuzzbee"]:
                    yield page.name, words[1:]


@pytest.mark.parametrize(("page", "arguments"), list(command_lines()))
def test_every_command_in_the_documents_is_one(page, arguments, capfd):
    """An unknown verb or option is an error, with --help too."""
    assert main([*arguments, "--help"]) == 0, page


def test_the_page_of_views_names_the_bounds_and_words_that_are_used():
    bounds = [f"over {bound:g}°" for bound in (*HORIZON_DEG, *HEADING_DEG)]
    words = [f"**{word}**" for word in WORDS.values()]
    assert not [each for each in (*bounds, *words) if each not in read("views.md")]


def test_links_between_the_documents_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_page_of_parameters_lists_them_all():
    script = str(DOCS / "parameters.py")
    done = run_python(script, "--check", timeout_s=120, folder=DOCS.parent, check=False)
    assert done.returncode == 0, "renew it: python docs/parameters.py"


def test_every_reason_for_a_refusal_is_explained():
    """Once each, with what came and what to do about it."""
    table = section("troubleshooting.md", "Samples are `rejected`")
    rows = [line.strip("| ").split(" | ") for line in table.splitlines() if line.startswith("| `")]
    explained = [word for row in rows for word in re.findall(r"`(\w+)`", row[0])]
    assert sorted(explained) == sorted(Reason)
    assert all(len(row) == 3 and min(map(len, row[1:])) > 20 for row in rows)


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_the_python_examples_run_as_they_stand(number, tmp_path, monkeypatch, capsys):
    """On the arrays and the log that they name, made of a recorded flight."""
    time_s, gyr, acc, mag, velocity, truth = recorded(FLIPS)
    np.savez(tmp_path / "imu.npz", time=time_s, gyr=gyr, acc=acc, mag=mag, velocity=velocity)
    (tmp_path / "flight.tlog").write_bytes(FLIPS.read_bytes())
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(blocks("python", read("python.md"))[number], "python.md", "exec"), names)
    assert capsys.readouterr().out
    if number == 1:  # after 20 s of flips, by velocity
        errors = batch_angle_errors(np.array([names["attitude"].q_ned_frd]), truth[-1:])
        assert np.degrees(errors[0, 2]) < 1.0


RATE_HZ = 100.0


def named(peer):
    """What the table's words of a filter name."""
    module = pytest.importorskip(peer)
    if peer == "vqf":
        return {"VQF": module.VQF, "vqf": module.VQF(1.0 / RATE_HZ)}
    if peer == "ahrs":
        kind = module.filters.Madgwick
        return {"Madgwick": kind, "madgwick": kind(frequency=RATE_HZ), "q": np.eye(4)[0]}
    if peer == "fuzzbee":
        return {"Estimator": module.Estimator, "frd": (1.0, -1.0, -1.0)}
    settings, ahrs = module.AhrsSettings(), module.Ahrs()
    settings.sample_rate = RATE_HZ
    ahrs.set_settings(settings)
    return {"ahrs": ahrs}


def rolled():
    """Readings of a level vehicle that rolls to 30 degrees; x forward, y left, z up."""
    roll_deg = np.array((*[0.0] * 300, *np.arange(0.0, 30.0, 0.3), *[30.0] * 100))
    turning = (roll_deg > 0.0) & (roll_deg < 30.0)
    none, roll = np.zeros(len(roll_deg)), np.radians(roll_deg)
    up = np.column_stack((none, np.sin(roll), np.cos(roll)))
    gyr = np.column_stack((np.radians(0.3 * RATE_HZ) * turning, none, none))
    return {"gyr": gyr, "acc": 9.81 * up, "mag": np.array((20.0, 0.0, 0.0)) - 40.0 * up}


def tilt_deg(quaternion):
    w, x, y, z = np.asarray(quaternion).ravel()
    return np.degrees(2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z)))


@pytest.mark.parametrize("peer", ["vqf", "ahrs", "imufusion", "fuzzbee"])
def test_the_words_of_filters_are_theirs(peer):
    """The batch of those that have one, and one call a sample."""
    ((batch, single),) = re.findall(rf"(?m)^\| {peer} \| (.*) \| (.*) \|$", read("python.md"))
    names, readings = {"np": np, "f": RATE_HZ, **named(peer)}, rolled()
    if peer != "imufusion":
        words = re.search(r"`(.*?)`", batch)[1]
        assert tilt_deg(eval(words, names | readings)[-1]) == pytest.approx(30.0, abs=1.0)
    if peer == "fuzzbee":
        return
    update, *attitude = (part.strip("` ") for part in single.split(";"))
    for names["gyr"], names["acc"], names["mag"] in zip(*readings.values(), strict=True):
        exec(update, names)
    assert tilt_deg(eval((*attitude, "q")[0], names)) == pytest.approx(30.0, abs=1.0)


# --- the example of docs/security.md, run as it stands there


@pytest.fixture
def configured(tmp_path):
    """Configurations of the example, with certificates by its own commands and another port."""
    if shutil.which("openssl") is None:
        pytest.skip("needs openssl")
    script, port = EXAMPLE / "certificates.sh", free_port()
    subprocess.run(["sh", "-e", str(script)], cwd=tmp_path, check=True, capture_output=True)

    def configuration(name):
        file = EXAMPLE / ("service.json5" if name == "service" else "tablet.json5")
        text = file.read_text("utf-8").replace(":7447", f":{port}").replace("tablet.", f"{name}.")
        text = re.sub(r'"(\w+\.(?:pem|key))"', lambda m: json.dumps(str(tmp_path / m[1])), text)
        path = tmp_path / f"{name}.json5"
        path.write_text(text)
        return str(path)

    return configuration


def first_attitude(session):
    records = heard(session, "fuzzbee/*/attitude")
    wait_for(lambda: records, 120.0)
    return records[0]


def answers(session, key, payload=None):
    replies = session.get(key, payload=payload, timeout=3.0)
    return [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]


def test_the_tablet_reads_the_office_changes_and_without_a_certificate_nobody_gets_in(configured):
    change = json.dumps({"filter": {"gamma": 2.0}})

    def client(name):
        return opened(zenoh.Config.from_file(configured(name)))

    with started("run", "sim:", "--rate", "20", "--json", "-c", configured("service")):
        with client("office") as office:
            assert first_attitude(office)["schema"] == 1
            wait_for(lambda: answers(office, "fuzzbee/1/parameters", change), 120.0)
            (profile,) = answers(office, "fuzzbee/1/parameters", change)
            assert json.loads(profile)["filter"]["gamma"] == 2.0
        with client("tablet") as tablet:
            assert first_attitude(tablet)["schema"] == 1
            wait_for(lambda: answers(tablet, "fuzzbee/*/status"), 120.0)
            assert answers(tablet, "fuzzbee/1/parameters", change) == []
        config = zenoh.Config.from_file(configured("nobody"))
        for key in ("connect_certificate", "connect_private_key"):
            config.insert_json5(f"transport/link/tls/{key}", "null")
        config.insert_json5("transport/link/tls/enable_mtls", "false")
        config.insert_json5("connect/timeout_ms", "3000")
        try:
            session = zenoh.open(config)
        except zenoh.ZError:
            return
        with session:  # TLS 1.3 lets the client believe so at first
            records = heard(session, "fuzzbee/*/attitude")
            time.sleep(3.0)
            assert not records
