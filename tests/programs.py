"""Python programs in processes of their own, and a folder with programs under our names."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

import estimator

PACKAGES = ("estimator", "drivers", "service", "tuning", "fuzzbee")
MODULES = ("numba", "numpy", "llvmlite", "typer", "rich", "msgspec", "zenoh", "sitecustomize")
ROOT = str(Path(next(iter(estimator.__path__))).parent)
NAMESPACE = ("unshare", "-Urm", "sh", "-c")  # a shell that may mount, which nobody else sees


def can_mount(probe):
    """Whether a shell of a namespace of its own can do the mounts of the ``probe``."""
    try:
        return not subprocess.run([*NAMESPACE, probe], capture_output=True, check=False).returncode
    except OSError:
        return False


def run_python(
    *command, timeout_s, folder=None, check=True, through=(), inherited=os.environ, **environment
):
    """Run ``python *command``, ``through`` another command; with ``check`` it has to end well."""
    path = os.pathsep.join(filter(None, [ROOT, os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [*through, sys.executable, *command],
        env={**inherited, "PYTHONPATH": path, **environment},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout_s,
    )
    assert not check or done.returncode == 0, done.stderr
    return done


@contextmanager
def largest_file(size):
    """No file may have more bytes: that stands for a disk that is full."""
    resource = pytest.importorskip("resource")
    before, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, most))


def set_trap(folder):
    """Modules named like ours and like libraries; any that runs writes its path to ``sprung``."""
    spring = f"open({str(folder / 'sprung')!r}, 'a').write(__file__ + '\\n')\n"
    for package in PACKAGES:
        (folder / package).mkdir(parents=True)
        for name in ("__init__", "kernels", "cli"):
            (folder / package / f"{name}.py").write_text(spring)
    for module in MODULES:
        (folder / f"{module}.py").write_text(spring)
