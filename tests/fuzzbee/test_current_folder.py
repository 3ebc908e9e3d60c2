"""Beside downloaded logs may lie programs under our names: they are not run."""

import json
import shutil
from functools import partial

import pytest

from drivers.mavlink.signing import state_path
from estimator.compilation.kernel_folder import user_cache
from tests.fuzzbee.recording import TAKEOFF
from tests.programs import run_python, set_trap

# what the installed command runs: its own folder is the first place to look for modules
SCRIPT = "import sys\nfrom fuzzbee.cli import entry_point\nsys.exit(entry_point())\n"


run = partial(run_python, timeout_s=900)


@pytest.mark.parametrize(
    ("spelling", "arguments"),
    [
        ("script", ("--version",)),
        ("script", ("replay", "sim:", "--json")),
        ("module", ("run", "--no-zenoh", "--seconds", "0.2", "--profile", "imu")),
    ],
)
def test_programs_in_the_current_folder_are_not_run(tmp_path, spelling, arguments):
    trap = tmp_path / "downloads"
    set_trap(trap)
    script = tmp_path / "bin" / "fuzzbee"
    script.parent.mkdir()
    script.write_text(SCRIPT)
    if spelling == "module":  # without fuzzbee itself, which Python looks up before we can act
        shutil.rmtree(trap / "fuzzbee")
    command = ["-m", "fuzzbee"] if spelling == "module" else [str(script)]
    run(*command, *arguments, folder=trap)
    assert not (trap / "sprung").exists(), (trap / "sprung").read_text()


def test_settings_for_numba_in_the_current_folder_are_not_read(tmp_path):
    """A file that numba would end at, and would look for again at each compilation."""
    (tmp_path / ".numba_config.yaml").write_text("- 1")
    compiling = "import estimator, numba; numba.core.config.reload_config(); print('read')"
    done = run("-c", compiling, folder=tmp_path)
    assert (done.stdout, done.stderr) == ("read\n", "")
    done = run("-m", "fuzzbee", "replay", str(TAKEOFF), "--json", folder=tmp_path)
    assert ".numba_config" not in done.stderr
    assert json.loads(done.stdout)["imu"]


def test_neither_settings_for_plots_nor_modules_of_the_current_folder_are_read(tmp_path):
    """Nor by the processes that share the work of ``check``."""
    pytest.importorskip("matplotlib", reason="the extra plot is not installed")
    (tmp_path / "matplotlibrc").write_bytes(b"\xff\xff")
    for name in ("multiprocessing", "pickle", "random", "struct"):
        (tmp_path / f"{name}.py").write_text("open('sprung', 'a').write(__name__)")
    run("-m", "fuzzbee", "replay", str(TAKEOFF), "--plot", "plot.png", folder=tmp_path)
    run("-m", "fuzzbee", "check", str(TAKEOFF), str(TAKEOFF), folder=tmp_path)
    assert not (tmp_path / "sprung").exists()


REPLAY = ("replay", str(TAKEOFF))
RUN = ("run", "sim:", "--seconds", "0.5", "-l", "tcp/127.0.0.1:0", "-e", "tcp/127.0.0.1:9")


@pytest.mark.parametrize(
    ("command", "switches"),
    [
        (REPLAY, {"NUMBA_DEBUG": "1", "NUMBA_CPU_NAME": "evil", "NUMBA_OPT": "0"}),
        (RUN, {"ZENOH_RUNTIME": "", "NUMPY_MADVISE_HUGEPAGE": "x", "NUMBA_NUM_THREADS": "0"}),
    ],
)
def test_switches_of_libraries_are_named_and_not_used(command, switches, tmp_path):
    """Some would end the service."""
    done = run("-m", "fuzzbee", *command, "--json", folder=tmp_path, **switches)
    first, *others = done.stderr.splitlines()
    assert first == f"fuzzbee: {', '.join(sorted(switches))}: not used by fuzzbee"
    assert not [line for line in others if "anic" in line or "Warning" in line]
    result = json.loads(done.stdout)
    assert (result["imu"] if command == REPLAY else result["vehicles"]["1"])["samples"] > 10


def test_a_relative_folder_for_states_is_nobodys(tmp_path, monkeypatch):
    """As in the XDG Base Directory Specification: the current folder may be anybody's."""
    monkeypatch.setenv("XDG_STATE_HOME", "here")
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_path() == tmp_path / ".local/state/fuzzbee/signing.json"
    assert user_cache() == tmp_path / ".cache/fuzzbee"
