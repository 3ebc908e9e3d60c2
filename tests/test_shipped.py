"""What is shipped: the container's files, its commands as processes here, libraries, licences."""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from tests.fuzzbee.processes import free_endpoint, free_port, started
from tests.fuzzbee.services import await_line
from tests.programs import run_python

ROOT = Path(__file__).parents[1]
DOCKERFILE = ROOT / "docker" / "Dockerfile"
COMPOSE = ROOT / "docker" / "compose.yaml"
HEALTHCHECK = ROOT / "docker" / "healthcheck.py"

pytestmark = pytest.mark.checkout


def tool(name):
    """A program beside the interpreter or on the path; the test is skipped without it."""
    folders = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    found = shutil.which(name, path=folders)
    return found or pytest.skip(f"{name} is not installed")


def services():
    return YAML(typ="safe").load(COMPOSE.read_text("utf-8"))["services"]


def instructions():
    """(word, arguments) of the Dockerfile, continued lines joined."""
    text = re.sub(r"^#.*\n", "", DOCKERFILE.read_text("utf-8"), flags=re.MULTILINE)
    lines = re.sub(r"\\\n", " ", text).splitlines()
    return [tuple(line.split(None, 1)) for line in lines if line.strip()]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("hadolint", [str(DOCKERFILE)]),
        ("check-jsonschema", ["--builtin-schema", "vendor.compose-spec", str(COMPOSE)]),
    ],
)
def test_the_tools_find_nothing(name, arguments):
    done = subprocess.run([tool(name), *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_kernels_are_built_by_the_command_that_a_wheel_uses_and_no_setting_moves_them():
    runs = [arguments for word, arguments in instructions() if word == "RUN"]
    assert any(arguments.rstrip().endswith("python -m fuzzbee.kernels") for arguments in runs)
    assert "NUMBA" not in DOCKERFILE.read_text("utf-8")
    assert "estimator/kernels" in (ROOT / ".dockerignore").read_text("utf-8").splitlines()


def test_everything_that_is_copied_reaches_the_build():
    """.dockerignore keeps all out and lets these in."""
    lines = (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    allowed = {line[1:] for line in lines if line.startswith("!")}
    assert "*" in lines
    for name in allowed:
        assert (ROOT / name).exists()
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    packages = re.search(r"^packages = \[(.*)\]", project, re.MULTILINE)[1]
    assert set(re.findall(r"\w+", packages)) <= allowed
    assert {"pyproject.toml", "constraints.txt", "README.md", "LICENSE"} <= allowed
    assert "docker/healthcheck.py" in allowed
    copied = [argument.split()[:-1] for word, argument in instructions() if word == "COPY"]
    named = {n for names in copied for n in names if not n.startswith(("-", "/", "."))}
    assert {"docker/libraries.txt", "docker/builder.txt"} == named
    assert named <= allowed


def test_every_service_is_the_one_image_locked_down_and_runs_as_nobody_in_particular():
    assert ("USER", "10001:10001") in instructions()
    for service in services().values():
        assert service["build"]["dockerfile"] == "docker/Dockerfile"
        assert (COMPOSE.parent / service["build"]["context"] / "docker/Dockerfile").exists()
        locked = [service[name] for name in ("image", "init", "read_only", "cap_drop")]
        assert locked == ["fuzzbee:local", True, True, ["ALL"]]


def test_the_commands_name_each_other():
    commands = [service["command"] for service in services().values()]
    addresses = [word for command in commands for word in command if ":" in word]
    hosts = {re.fullmatch(r"\w+[:/]([\w.]+):\d+", address)[1] for address in addresses}
    assert hosts == {"0.0.0.0", "sim", "service"}


def health(endpoint):
    given = {"FUZZBEE_HEALTH_ENDPOINT": endpoint}
    return run_python(str(HEALTHCHECK), timeout_s=120, check=False, **given)


def test_the_composition_shows_attitudes_and_is_healthy():
    link, session = free_port(), free_port()
    private = ["--cfg", f"listen/endpoints:{json.dumps([free_endpoint()])}"]

    def here(name):
        text = json.dumps(services()[name]["command"])
        for service, own in ((":5760", link), (":7447", session)):
            text = re.sub(rf"(0\.0\.0\.0|sim|service){service}", f"127.0.0.1:{own}", text)
        return json.loads(text)

    endpoint = f"tcp/127.0.0.1:{session}"
    assert health(endpoint).returncode == 1  # nobody there
    with started(*here("service")) as service:
        await_line(service, "trying again")  # the vehicle comes later: that is no fault
        assert health(endpoint).stdout == "0 vehicles\n"
        with started(*here("sim")), started(*here("watch"), *private) as watch:
            lines = [watch.stdout.readline() for _ in range(3)]
            checked = health(endpoint)
    assert all(re.search(r"1  (running|waiting)", line) for line in lines)
    assert "running" in lines[-1]
    assert "roll" in lines[-1]
    assert (checked.returncode, checked.stdout) == (0, "1 vehicles\n")


# --- what is installed with us: its licences, and the container's libraries by their hashes

EXTRAS = ("plot", "page", "mcap", "bags", "metrics", "viewer", "cluster", "optimizers")
PERMISSIVE = re.compile(r"MIT|BSD|ISC|PSF|Python Software Foundation|Apache")
# In docs by name: what is not permissive, or says nothing in its metadata.
NAMED = {"apsw", "pymavlink", "scikit-fuzzy"}


def canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()


def dependencies(name, extras):
    """Names of all that a distribution brings here, itself left out."""
    packaging = pytest.importorskip("packaging.requirements")
    found, todo = set(), [(name, extras)]
    while todo:
        name, extras = todo.pop()
        for text in distribution(name).requires or []:
            required = packaging.Requirement(text)
            marker, dependency = required.marker, canonical(required.name)
            if marker and not any(marker.evaluate({"extra": extra}) for extra in ("", *extras)):
                continue
            if dependency not in found:
                found.add(dependency)
                todo.append((dependency, tuple(required.extras)))
    return found


def licence(name):
    """What its metadata says, in the order in which tools came to say it."""
    metadata = distribution(name).metadata
    classifiers = [each for each in metadata.get_all("Classifier", []) if "License" in each]
    output = (metadata.get("License-Expression"), *classifiers, metadata.get("License"))
    return " ".join(each for each in output if each)


def test_every_dependency_is_permissive_or_named_in_the_docs():
    try:
        names = dependencies("fuzzbee", EXTRAS)
    except PackageNotFoundError as error:
        pytest.skip(f"not all extras are installed: {error}")
    assert len(names) > 40
    others = {name for name in names if not PERMISSIVE.search(licence(name))}
    assert others == NAMED
    section = (ROOT / "docs" / "security.md").read_text("utf-8").partition("## Licences")[2]
    assert all(f"`{name}`" in section for name in NAMED)


def locked(name):
    """The versions in a file of the container's, each with hashes."""
    text = (ROOT / "docker" / name).read_text("utf-8").replace("\\\n", " ")
    lines = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    for _, *hashes in lines:
        assert hashes
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", each) for each in hashes)
    return {canonical(n): v for n, _, v in (line[0].partition("==") for line in lines)}


def test_the_containers_libraries_have_hashes_and_the_versions_that_are_tested():
    text = (ROOT / "constraints.txt").read_text("utf-8")
    pins = re.findall(r"^([\w.-]+)==(\S+)", text, re.MULTILINE)
    tested = {canonical(name): version for name, version in pins}
    libraries, builder = locked("libraries.txt"), locked("builder.txt")
    assert len(libraries) > 20
    assert "hatchling" in builder  # pip refuses what it needs and is not listed
    for name, version in (libraries | builder).items():
        assert tested[name] == version
    assert dependencies("fuzzbee", ("metrics",)) == set(libraries)
