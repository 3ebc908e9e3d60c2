"""Compiled or not, kept or not: the same numbers, and one line of warning at most."""

import ast
import os
import shutil
from pathlib import Path
from typing import NamedTuple

import pytest
from numba.core.errors import TypingError

import drivers
import estimator
import tuning
from estimator.compilation.compiled import compiled, is_compiled_code
from tests.programs import NAMESPACE, can_mount, run_python

# One kernel, which compiles within a second.
SMALL_PROGRAM = """
from estimator.compilation.compiled import compiled
from estimator.filter.noise_gain import rules_gain
noise_surface = compiled()(rules_gain)
print([noise_surface(1.0 + 0.01 * i, 0.01 * i, 0.013 * i).hex() for i in range(101)])
"""
MISSES = "print(sum(noise_surface.stats.cache_misses.values()))\n"
PLACE = "print(noise_surface.stats.cache_path)\n"


def run(program=SMALL_PROGRAM, *, sources, through=(), **environment):
    """The program's output, errors and status; it sees the packages in ``sources``."""
    inherited = {key: value for key, value in os.environ.items() if "NUMBA" not in key}
    environment["PYTHONPATH"] = str(sources)
    command = ("-P", "-c", program)
    return run_python(*command, timeout_s=300, through=through, inherited=inherited, **environment)


OWN = Path(estimator.__file__).parents[1]
# Some seconds of the filter in plain Python; prints every digit.
PROGRAM = """
from drivers.simulation.simulated_vehicle import simulate
from estimator.filter.fuzzy import fuzzy_gain
from estimator.filter.memberships import LOWER, UPPER, midpoint
from estimator.live.settings import settings_of
from estimator.profile import load_profile
from tuning.paper_experiment import filtered

q, gains = filtered(settings_of(load_profile("paper")), simulate(5, 200))
numbers = [*q[-1].tolist(), float(gains.sum())]
for k in (LOWER, midpoint(), UPPER):
    numbers += [fuzzy_gain(k, 0.01 * i, 0.013 * i) for i in range(101)]
print([x.hex() for x in numbers])
"""
NOTIFYING = """
from estimator.compilation.kernel_folder import notify_compiling
notify_compiling(lambda text: print("notice:", text))
"""


@pytest.fixture
def sources(tmp_path):
    """A clone in which nothing is compiled."""
    for package in (estimator, drivers, tuning):
        source = Path(package.__file__).parent
        ignored = shutil.ignore_patterns("__pycache__", "kernels")
        shutil.copytree(source, tmp_path / "clone" / source.name, ignore=ignored)
    return tmp_path / "clone"


def notices(result):
    return [line for line in result.stdout.splitlines() if line.startswith("notice:")]


def test_plain_python_gives_the_same_results():
    """The two differ only in the last digits of sine, cosine and exponential."""
    plain = run(PROGRAM, sources=OWN, NUMBA_DISABLE_JIT="1")
    compiled = run(PROGRAM, sources=OWN)
    assert plain.stderr == compiled.stderr == ""
    both = (map(float.fromhex, ast.literal_eval(each.stdout)) for each in (plain, compiled))
    for one, other in zip(*both, strict=True):
        # 200 steps of an unstable start multiply roundings of 1e-16 by some thousands
        assert abs(one - other) <= 1e-9 * (1.0 + abs(other))


def test_kernels_are_compiled_once_and_kept_beside_the_sources(sources):
    program = NOTIFYING + SMALL_PROGRAM + PLACE + MISSES
    # neither numba's own setting nor the current folder's counts
    cold = run(program, sources=sources, NUMBA_CACHE_DIR=str(sources / "other"))
    assert len(notices(cold)) == 1
    assert cold.stdout.splitlines()[-1] == "1"
    assert str(sources / "estimator" / "kernels") in cold.stdout
    assert not (sources / "other").exists()
    for first in ("", "import numba\n"):  # it does not change which CPU they are made for
        warm = run(first + program, sources=sources)
        assert notices(warm) == []
        assert warm.stdout.splitlines()[-1] == "0"
        assert warm.stdout.splitlines()[0] == cold.stdout.splitlines()[1]
        assert warm.stderr == cold.stderr == ""


def test_a_change_of_an_inlined_function_in_another_file_is_noticed(sources):
    before = run(SMALL_PROGRAM, sources=sources).stdout
    other = sources / "estimator" / "geometry" / "quaternion.py"
    other.write_text(other.read_text("utf-8") + "\n# another comment\n")
    after = run(SMALL_PROGRAM + MISSES, sources=sources).stdout.splitlines()
    assert after == [before.strip(), "1"]
    assert len(list((sources / "estimator" / "kernels").iterdir())) == 2


def test_where_the_sources_cannot_be_written_to_it_is_the_users_cache_folder(sources, tmp_path):
    (sources / "estimator" / "kernels").write_text("no folder")
    cache = tmp_path / "cache"
    result = run(SMALL_PROGRAM + PLACE, sources=sources, XDG_CACHE_HOME=str(cache))
    assert str(cache / "fuzzbee") in result.stdout
    again = run(SMALL_PROGRAM + MISSES, sources=sources, XDG_CACHE_HOME=str(cache))
    assert again.stdout.splitlines()[-1] == "0"


@pytest.mark.skipif(os.name != "posix", reason="needs modes of files")
def test_kernels_that_others_may_have_put_there_are_not_run(sources, tmp_path):
    (sources / "estimator" / "kernels").write_text("no folder")
    cache = tmp_path / "cache"
    (cache / "fuzzbee").mkdir(parents=True)
    (cache / "fuzzbee").chmod(0o777)
    result = run(NOTIFYING + SMALL_PROGRAM, sources=sources, XDG_CACHE_HOME=str(cache))
    assert len(notices(result)) == 1
    assert "others may write to it" in result.stderr
    assert not list((cache / "fuzzbee").rglob("*.nbc"))


def test_without_any_folder_it_compiles_in_memory_and_warns_once(sources):
    (sources / "estimator" / "kernels").write_text("no folder")
    below = str(sources / "estimator" / "kernels" / "below")
    result = run(NOTIFYING + SMALL_PROGRAM, sources=sources, XDG_CACHE_HOME=below)
    assert len(notices(result)) == 1
    (warning,) = [line for line in result.stderr.splitlines() if "Warning" in line]
    assert "no writable folder for compiled code" in warning


READ_ONLY = "mount -t tmpfs tmpfs /mnt && mount -o remount,ro /mnt"


@pytest.mark.skipif(os.name != "posix" or not can_mount(READ_ONLY), reason="needs user namespaces")
def test_kernels_on_a_read_only_file_system_are_used(sources):
    """As in a container: the folder cannot be written, yet nothing is compiled again."""
    expected = run(SMALL_PROGRAM, sources=sources).stdout
    bind = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'
    through = (*NAMESPACE, bind, str(sources))
    program = SMALL_PROGRAM + MISSES
    done = run(program, sources=sources, through=through, PYTHONDONTWRITEBYTECODE="1")
    *lines, misses = done.stdout.splitlines()
    assert "\n".join(lines) == expected.strip()
    assert misses == "0"
    assert done.stderr == ""


class Two(NamedTuple):
    first: float
    last: int


def test_a_value_without_a_name_is_refused():
    changed = compiled()(lambda two, value: two._replace(value))
    with pytest.raises((TypingError, TypeError), match=r"by name|positional"):
        changed(Two(1.0, 4), 2.5)


@pytest.mark.skipif(not is_compiled_code(), reason="plain Python casts nothing")
@pytest.mark.parametrize(
    ("changed", "field"),
    [
        (lambda two, value: two._replace(middle=value), "middle"),
        (lambda two, value: two._replace(last=value), "last"),
    ],
)
def test_a_strange_field_and_a_value_of_another_type_are_refused(changed, field):
    with pytest.raises(TypingError, match=f"float64 is no value for the field '{field}'"):
        compiled()(changed)(Two(1.0, 4), 2.5)
