"""Where a person's output goes: through his own symbolic links, through nobody else's."""

import os
from pathlib import Path

import pytest

from drivers.mavlink.recorder import Recorder
from drivers.output_file import output_path, written_for, written_whole
from estimator.errors import InputError

needs_root = pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="needs root")


def linked(tmp_path):
    target, link = tmp_path / "target", tmp_path / "link"
    target.touch()
    link.symlink_to(target)
    return target, link


def replace(path):
    with written_for("--output", path) as fresh:
        fresh.write_bytes(b"whole")


def test_our_own_link_is_followed_and_stays(tmp_path):
    target, link = linked(tmp_path)
    replace(link)
    assert target.read_bytes() == b"whole"
    assert link.is_symlink()
    assert output_path(tmp_path / "not there") == tmp_path / "not there"


@needs_root
@pytest.mark.parametrize("write", [output_path, Recorder, replace])
def test_somebody_elses_is_not(tmp_path, write):
    target, link = linked(tmp_path)
    os.chown(link, 4321, 4321, follow_symlinks=False)
    with pytest.raises(InputError, match="somebody else's symbolic link"):
        write(link)
    assert target.read_bytes() == b""


def test_a_file_that_was_there_keeps_its_rights(tmp_path):
    file = tmp_path / "a.csv"
    os.umask(umask := os.umask(0))
    for rights in (0o666 & ~umask, 0o600):
        with written_whole(file) as fresh:
            fresh.write_bytes(b"whole")
        assert file.read_bytes() == b"whole"
        assert file.stat().st_mode & 0o777 == rights
        file.chmod(0o600)


def test_a_device_is_written_to_itself():
    with written_whole(Path(os.devnull)) as file:
        assert file == Path(os.devnull)


def test_links_in_a_circle_are_one_line(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(InputError, match=r"cannot be|cannot record"):
        Recorder(tmp_path / "a")


def test_frames_are_appended_to_a_tlog_and_to_nothing_else(tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("not a recording")
    with pytest.raises(InputError, match="it is there, and no tlog"):
        Recorder(notes)
    assert notes.read_text() == "not a recording"
