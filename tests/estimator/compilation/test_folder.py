"""What is run as machine code lies where only we and root can write; what others left stays."""

import os
import stat
from pathlib import Path

import pytest

from estimator.compilation import folder as folders
from estimator.compilation.folder import environment_digest, forget_older, mistrust
from tests.estimator.compilation.small_program import MISSES, PLACE, SMALL_PROGRAM, run

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs owners and modes")

NAME = "kernels-0123456789abcdef"
DATA = "estimator.filter.fuzzy.fuzzy_gain-0123456789abcdef.py311.1.nbc"


def made(*parts, mode=0o755):
    path = Path(*parts)
    path.mkdir(parents=True, exist_ok=True)
    path.chmod(mode)
    return path.resolve()


def test_a_folder_of_ours_is_trusted(tmp_path):
    folder = made(tmp_path, "cache", NAME)
    (folder / DATA).write_bytes(b"")
    assert mistrust(folder) is None


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o757])
def test_a_folder_that_others_may_write_to_is_not(tmp_path, mode):
    assert "others may write" in mistrust(made(tmp_path, NAME, mode=mode))


@pytest.mark.parametrize(("mode", "is_trusted"), [(0o777, False), (0o1777, True), (0o755, True)])
def test_a_parent_that_others_may_write_to_needs_the_sticky_bit(tmp_path, mode, is_trusted):
    parent = made(tmp_path, "parent")
    folder = made(parent, "cache", NAME)
    parent.chmod(mode)
    assert (mistrust(folder) is None) == is_trusted


def test_a_file_that_others_may_write_to(tmp_path):
    folder = made(tmp_path, NAME)
    (folder / DATA).write_bytes(b"")
    (folder / DATA).chmod(0o666)
    assert DATA in mistrust(folder)


@pytest.mark.parametrize("level", ["parent", "folder", "file"])
def test_what_belongs_to_somebody_else(tmp_path, monkeypatch, level):
    """Seen from another user's side: what is ours is then somebody else's to him."""
    parent = made(tmp_path, "parent")
    folder = made(parent, NAME)
    (folder / DATA).write_bytes(b"")
    theirs = {"parent": parent, "folder": folder, "file": folder / DATA}[level]
    real = folders._open_to_others

    def seen(path, about, **options):
        if path == theirs:
            values = list(about)
            values[stat.ST_UID] = os.geteuid() + 4321
            about = os.stat_result(values)
        return real(path, about, **options)

    monkeypatch.setattr(folders, "_open_to_others", seen)
    assert mistrust(folder) == f"{theirs} belongs to somebody else"


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="needs root")
def test_what_really_belongs_to_somebody_else(tmp_path):
    folder = made(tmp_path, "theirs", NAME)
    os.chown(folder.parent, 4321, 4321)
    assert mistrust(folder) == f"{folder.parent} belongs to somebody else"


KERNEL = SMALL_PROGRAM + PLACE


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
def test_a_chosen_folder_that_is_open_to_others_is_told_and_not_used(tmp_path):
    chosen, private = made(tmp_path, "open", mode=0o777), made(tmp_path, "home")
    done = run(KERNEL, NUMBA_CACHE_DIR=str(chosen), XDG_CACHE_HOME=str(private))
    assert str(private / "fuzzbee") in done.stdout
    assert not list(chosen.rglob("*.nb?"))
    lines = [line for line in done.stderr.splitlines() if "Warning" in line]
    assert len(lines) == 1
    assert f"NUMBA_CACHE_DIR={chosen} is not used: others may write to {chosen}" in lines[0]


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
def test_a_folder_that_cannot_be_written_is_read_and_the_next_one_takes_the_rest(tmp_path, cache):
    """Root has compiled for all, but not everything: the others need not do it at each start."""
    chosen, private = cache, made(tmp_path, "home")
    places = {"NUMBA_CACHE_DIR": str(chosen), "XDG_CACHE_HOME": str(private)}
    read_only = f"""
import os
real = os.access
os.access = lambda path, mode: real(path, mode) and not (
    mode & os.W_OK and str(path).startswith({str(chosen)!r})
)
"""
    assert run(read_only + SMALL_PROGRAM + MISSES, **places).stdout.endswith("\n0\n")
    assert not list(private.rglob("*.nb?"))
    for path in chosen.rglob("*.nb?"):
        path.unlink()
    assert run(read_only + SMALL_PROGRAM + MISSES, **places).stdout.endswith("\n1\n")
    assert list(private.rglob("*.nb?"))
    assert not list(chosen.rglob("*.nb?"))
    assert run(read_only + SMALL_PROGRAM + MISSES, **places).stdout.endswith("\n0\n")


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
def test_what_a_wheel_brings_for_any_cpu_is_taken_and_nothing_is_compiled(tmp_path):
    """Unless it was made for other libraries, or others can write to it."""
    made_in, own, brought = made(tmp_path, "made"), made(tmp_path, "own"), made(tmp_path, "brought")
    generic = run(NUMBA_CPU_NAME="generic", NUMBA_CACHE_DIR=str(made_in))
    with_brought = f"""
from pathlib import Path
from estimator.compilation import folder
folder.SHIPPED = Path({str(brought)!r})
from estimator.compilation.compiled import OPTIONS
print(folder.PREFIX + folder.shipped_digest(OPTIONS))
"""
    (name,) = run(with_brought).stdout.split()
    made(brought, name)
    for path in next(made_in.iterdir()).iterdir():
        path.rename(brought / name / path.name)

    def started(before=""):
        lines = run(before + with_brought + SMALL_PROGRAM + MISSES, NUMBA_CACHE_DIR=str(own)).stdout
        return lines.splitlines()

    _, gain, missed = started()
    assert gain == generic.stdout.strip()
    assert missed == "0"
    assert not list(own.rglob("*.nb?"))
    assert started("import numba; numba.__version__ = '0.1'\n")[-1] == "1"
    for path in own.rglob("*.nb?"):
        path.unlink()
    (brought / name).chmod(0o777)
    assert started()[-1] == "1"


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
@pytest.mark.parametrize(("pattern", "damage"), [("*.nbi", b"\x80\x04nonsense"), ("*.nbc", b"")])
def test_a_damaged_file_is_compiled_again(cache, expected, pattern, damage):
    """As a loss of power leaves them."""
    for path in cache.rglob(pattern):
        path.write_bytes(damage)
    for misses in "10":
        done = run(SMALL_PROGRAM + MISSES, NUMBA_CACHE_DIR=str(cache))
        assert (done.stdout, done.stderr) == (f"{expected}{misses}\n", "")


@pytest.mark.skipif(bool(os.environ.get("NUMBA_DISABLE_JIT")), reason="nothing is compiled")
def test_an_index_of_another_version_is_begun_anew(tmp_path):
    """A process of that version has written it since it was read, and names a class of its own."""
    places = {"NUMBA_CACHE_DIR": str(made(tmp_path, "cache"))}
    beside = r"""
import pickle, numba
from estimator.compilation.kernel_cache import KernelCache
keep = KernelCache.save_overload
def keep_beside(cache, signature, data):
    stamp = pickle.dumps(numba.__version__)
    cache._files[-1]._index.write_bytes(stamp + b"cno_such_module\nNoSuchClass\n.")
    keep(cache, signature, data)
KernelCache.save_overload = keep_beside
"""
    first = run(beside + SMALL_PROGRAM, **places)
    again = run(SMALL_PROGRAM + MISSES, **places)
    assert (again.stdout, first.stderr) == (first.stdout + "0\n", "")


def test_only_our_own_folders_are_forgotten_and_of_them_only_what_we_wrote(tmp_path):
    theirs = ("kernels-6.1.0", "kernels-", "kernels-0123456789abcdeg", "kernels-0123456789abcdef0",
              "kernels-0123456789ABCDEF", "my-kernels-0123456789abcdef")  # fmt: skip
    for name in theirs:
        (made(tmp_path, name) / "vmlinuz").write_text("theirs")
        (tmp_path / name / DATA).write_text("theirs, whatever it is called")
        os.utime(tmp_path / name, (1, 1))
    (tmp_path / "kernels-00000000000000aa").write_text("a file")
    elsewhere = made(tmp_path, "elsewhere")
    (elsewhere / DATA).write_text("linked")
    (tmp_path / "kernels-00000000000000bb").symlink_to(elsewhere)
    for number in range(8):
        folder = made(tmp_path, f"kernels-{number:016x}")
        for name in (DATA, DATA.replace("1.nbc", "nbi"), f"{DATA}.tmp.0123456789abcdef"):
            (folder / name).write_text("ours")
        if number == 2:
            (folder / "notes.txt").write_text("somebody's")
            (made(folder, "below") / DATA).write_text("somebody's")
        os.utime(folder, (1000 + number, 1000 + number))
    forget_older(tmp_path, "kernels-0000000000000007")
    left = {path.name for path in tmp_path.iterdir() if path.name.startswith("kernels-0000")}
    assert left == {f"kernels-{k:016x}" for k in (2, 4, 5, 6, 7)} | {
        "kernels-00000000000000aa",
        "kernels-00000000000000bb",
    }
    kept = sorted(path.name for path in (tmp_path / "kernels-0000000000000002").rglob("*"))
    assert kept == ["below", DATA, "notes.txt"]
    assert (elsewhere / DATA).read_text() == "linked"
    for name in theirs:
        assert (tmp_path / name / "vmlinuz").read_text() == "theirs"
        assert (tmp_path / name / DATA).exists()


def test_what_changes_machine_code_changes_the_folder(monkeypatch):
    before = environment_digest("options")
    assert environment_digest("other options") != before
    for name, value, changes in (
        ("NUMBA_OPT", "1", True),
        ("NUMBA_BOUNDSCHECK", "1", True),
        ("NUMBA_CPU_NAME", "generic", True),
        ("NUMBA_SOMETHING_NEW", "1", True),
        ("NUMBA_NUM_THREADS", "1", False),
        ("NUMBA_CACHE_DIR", "/somewhere", False),
        ("FUZZBEE_LOGS", "/somewhere", False),
    ):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            assert (environment_digest("options") != before) == changes, name
    with monkeypatch.context() as patch:
        patch.setattr("numba.config.OPT", 1)  # as .numba_config.yaml does
        assert environment_digest("options") != before
    assert environment_digest("options") == before


def test_a_user_without_a_home_has_the_other_places(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "expanduser", _no_home)
    assert folders._bases(None) == [Path(folders.__file__).parents[1] / "__pycache__"]


def _no_home(path):
    raise RuntimeError("Could not determine home directory.")
