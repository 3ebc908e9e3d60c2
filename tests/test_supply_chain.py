"""What is installed with us: its licences, and a container's libraries by their hashes."""

import re
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXTRAS = ("plot", "page", "mcap", "bags", "metrics", "viewer", "cluster", "optimizers")
PERMISSIVE = re.compile(r"MIT|BSD|ISC|PSF|Python Software Foundation|Apache")
# In docs by name: what is not permissive, or says nothing in its metadata.
NAMED = {"apsw", "pymavlink", "scikit-fuzzy"}

pytestmark = pytest.mark.checkout


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
