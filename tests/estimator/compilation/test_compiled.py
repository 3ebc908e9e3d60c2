"""Compiled or not, cached or not: the same numbers, and one line of warning at most."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import estimator
from tests.estimator.compilation.small_program import MISSES, SMALL_PROGRAM, run

# Some seconds of the filter in plain Python; prints every digit.
PROGRAM = """
from drivers.simulation.simulated_vehicle import simulate
from estimator.filter import kernel
from estimator.filter.types import initial_state
from estimator.filter.fuzzy import fuzzy_gain
from estimator.filter.memberships import LOWER, UPPER, midpoint
from estimator.profile import load_profile
from estimator.live.settings import settings_of

chosen = settings_of(load_profile("paper"))
signals = simulate(5, 200)
columns = (signals.gyr_rad_s, signals.acc_m_s2, signals.mag_gauss)
start = initial_state(chosen.initial)
q, gains = kernel.run(chosen.filter, chosen.reference, start, *columns, 0.01)
print([x.hex() for x in q[-1].tolist()], float(gains.sum()).hex())
for k in (LOWER, midpoint(), UPPER):
    print([fuzzy_gain(k, 0.01 * i, 0.013 * i).hex() for i in range(101)])
"""


def numbers(result):
    import ast

    lines = [line.replace("] ", "], ") for line in result.stdout.splitlines()]
    first, *rest = lines
    attitude, total = first.rsplit(", ", 1)
    values = [*ast.literal_eval(attitude), total]
    for line in rest:
        values += ast.literal_eval(line)
    return [float.fromhex(value) for value in values]


def test_plain_python_gives_the_same_results():
    """The two differ only in the last digits of sine, cosine and exponential."""
    plain = run(PROGRAM, NUMBA_DISABLE_JIT="1")
    ours = {key: os.environ[key] for key in ("NUMBA_CACHE_DIR",) if key in os.environ}
    compiled = run(PROGRAM, **ours)  # where this process keeps what it compiles, too
    assert plain.stderr == compiled.stderr == ""
    for one, other in zip(numbers(plain), numbers(compiled), strict=True):
        # 200 steps of an unstable start multiply roundings of 1e-16 by some thousands
        assert abs(one - other) <= 1e-9 * (1.0 + abs(other))


CALLER = """
import numba

@numba.njit
def twice(number):
    return 2.0 * noise_surface(number, 0.5, 0.1)

(form,) = noise_surface.overloads.values()
print(len(list(form.library._shared_module.functions)))
print(twice(1.5) == 2.0 * noise_surface(1.5, 0.5, 0.1))
"""


def test_a_kernel_from_the_cache_has_what_its_callers_need_only_once_there_are_some(
    cache, expected
):
    assert list(cache.rglob("*.nbi"))
    result = run(SMALL_PROGRAM + CALLER + MISSES, NUMBA_CACHE_DIR=str(cache))
    assert result.stdout == f"{expected}0\nTrue\n0\n"


TOLD = """
from estimator.compilation.notice import tell_compiling
tell_compiling(lambda text: print("told:", text))
"""


def told(result):
    return [line for line in result.stdout.splitlines() if line.startswith("told:")]


def test_compiling_is_told_once_when_it_happens_and_never_else(tmp_path):
    cold = run(TOLD + SMALL_PROGRAM, NUMBA_CACHE_DIR=str(tmp_path))
    assert told(cold) == ["told: compiling the filter, the first time only"]
    assert told(run(TOLD + SMALL_PROGRAM, NUMBA_CACHE_DIR=str(tmp_path))) == []
    (kept,) = tmp_path.rglob("*.1.nbc")
    kept.unlink()
    assert len(told(run(TOLD + SMALL_PROGRAM, NUMBA_CACHE_DIR=str(tmp_path)))) == 1


def test_a_program_is_told_on_standard_error_and_a_command_says_it_itself(tmp_path):
    asked = "from estimator.compilation import notice\n"
    program = f"{asked}notice.tell_programs()\n"
    line = "fuzzbee: compiling the filter, the first time only, half a minute\n"
    assert run(program + SMALL_PROGRAM, NUMBA_CACHE_DIR=str(tmp_path)).stderr == line
    said = "notice.tell_compiling(print)\nnotice.compiling_begins(is_kept=True)\n"
    command = f"{asked}{said}notice.tell_programs()\nnotice.compiling_begins(is_kept=True)"
    result = run(command)
    assert (result.stdout.count("compiling"), result.stderr) == (1, "")


def test_without_a_cache_folder_it_compiles_in_memory_and_says_so_once(tmp_path, expected):
    """Nobody can make a folder below a file, not even root; the other places are closed."""
    blocked = tmp_path / "file"
    blocked.write_text("not a folder", "utf-8")
    below = str(blocked / "below")
    result = run(TOLD + SMALL_PROGRAM, NUMBA_CACHE_DIR=below, XDG_CACHE_HOME=below)
    assert result.stdout == f"told: compiling the filter\n{expected}"
    warnings = [line for line in result.stderr.splitlines() if "Warning" in line]
    assert len(warnings) == 1
    assert "no writable folder for compiled code" in warnings[0]


@pytest.mark.skipif(os.name != "posix", reason="needs resource limits")
def test_a_disk_too_full_for_the_cache_does_not_stop_it(tmp_path, expected):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
    result = run(
        limit + SMALL_PROGRAM, NUMBA_CACHE_DIR=str(tmp_path / "full"), PYTHONDONTWRITEBYTECODE="1"
    )
    assert result.stdout == expected
    warnings = [line for line in result.stderr.splitlines() if "Warning" in line]
    assert len(warnings) == 1
    assert "File too large" in warnings[0]


def can_bind_read_only():
    try:
        probe = [
            "unshare",
            "-Urm",
            "sh",
            "-c",
            "mount -t tmpfs tmpfs /mnt && mount -o remount,ro /mnt",
        ]
        return not subprocess.run(probe, capture_output=True, check=False).returncode
    except OSError:
        return False


@pytest.mark.skipif(os.name != "posix" or not can_bind_read_only(), reason="needs user namespaces")
def test_kernels_on_a_read_only_file_system_are_used(tmp_path, cache, expected):
    """As in a container: the folder cannot be written, yet nothing is compiled again."""
    script = tmp_path / "program.py"
    script.write_text(SMALL_PROGRAM + MISSES)
    root = str(Path(next(iter(estimator.__path__))).parent)
    commands = f"mount --bind '{cache}' '{cache}' && mount -o remount,ro,bind '{cache}' && "
    done = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", f"{commands} exec '{sys.executable}' '{script}'"],
        env={
            **{key: value for key, value in os.environ.items() if "NUMBA" not in key},
            "NUMBA_CACHE_DIR": str(cache),
            "PYTHONPATH": root,
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    *lines, misses = done.stdout.splitlines()
    assert "\n".join(lines) == expected.strip()
    assert misses == "0"
    assert done.stderr == ""
