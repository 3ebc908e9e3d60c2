"""Beside downloaded logs may lie programs under our names: they are not run."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import fuzzbee
from tests.traps import set_trap

ROOT = str(Path(next(iter(fuzzbee.__path__))).parent)
# what the installed command runs: its own folder is the first place to look for modules
SCRIPT = "import sys\nfrom fuzzbee.cli import entry_point\nsys.exit(entry_point())\n"


def run(folder, *command):
    path = os.pathsep.join(filter(None, [ROOT, os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, *command],
        env={**os.environ, "PYTHONPATH": path},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )


@pytest.mark.parametrize("spelling", ["script", "module"])
@pytest.mark.parametrize(
    "arguments",
    [
        ("--version",),
        ("replay", "sim:", "--json"),
        ("run", "--no-zenoh", "--seconds", "0.2", "--profile", "imu"),
    ],
)
def test_programs_in_the_current_folder_are_not_run(tmp_path, spelling, arguments):
    trap = tmp_path / "downloads"
    set_trap(trap)
    script = tmp_path / "bin" / "fuzzbee"
    script.parent.mkdir()
    script.write_text(SCRIPT)
    if spelling == "module":  # without fuzzbee itself, which Python looks up before we can act
        for name in ("__init__", "warm_up", "cli"):
            (trap / "fuzzbee" / f"{name}.py").unlink()
        (trap / "fuzzbee").rmdir()
    done = run(trap, *(["-m", "fuzzbee"] if spelling == "module" else [str(script)]), *arguments)
    assert done.returncode == 0, done.stderr
    assert not (trap / "sprung").exists(), (trap / "sprung").read_text()


def test_a_source_checkout_runs_from_its_own_folder():
    done = run(ROOT, "-m", "fuzzbee", "--version")
    assert done.returncode == 0, done.stderr
