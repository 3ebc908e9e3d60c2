"""A log that shrinks, or whose disk fails, while it is read: what came so far counts."""

import errno
import io
import shutil
from pathlib import Path

import pytest

from drivers.events import Imu
from drivers.logs.log_file import windowed
from drivers.logs.open import open_log
from estimator.errors import InputError

DATA = Path(__file__).parents[2] / "data"


@pytest.mark.parametrize("name", ["px4_hover.ulg", "sub_bluerov.tlog", "copter_reboot.tlog"])
def test_a_log_that_is_truncated_while_it_is_iterated(tmp_path, name):
    """As logrotate's copytruncate does; a mapped file ends the process with SIGBUS."""
    path = tmp_path / name
    shutil.copyfile(DATA / name, path)
    expected = sum(isinstance(event, Imu) for event in open_log(path))
    seen = 0
    for event in open_log(path):
        seen += isinstance(event, Imu)
        if seen == 3 and path.stat().st_size:
            path.write_bytes(b"")
    assert seen == expected > 100


class Failing(io.RawIOBase):
    """A file of which a part can be read: then it ends, or the disk fails."""

    def __init__(self, path, size, error):
        self._file, self._left, self._error = path.open("rb", buffering=0), size, error

    def readinto(self, buffer):
        if self._left == 0 and self._error is not None:
            raise OSError(self._error, "Input/output error")
        count = self._file.readinto(memoryview(buffer)[: min(len(buffer), self._left)])
        self._left -= count
        return count

    def close(self):
        self._file.close()
        super().close()


def test_a_file_of_which_only_a_part_can_be_read(tmp_path, monkeypatch, caplog):
    path = tmp_path / "log.bin"
    path.write_bytes(bytes(range(256)) * 100)
    monkeypatch.setattr(Path, "open", opens(path, Failing, 10_001, errno.EIO))
    with windowed(path) as window:
        window.move(0)
        assert window.data == (bytes(range(256)) * 100)[:10_001]
    assert "read no further: Input/output error" in caplog.text


def opens(path, how, *arguments):
    """What ``Path.open`` is then: this file is opened like that, all others are as they were."""
    real = Path.open

    def open_it(self, *args, **options):
        if self == path:
            return how(_Real(self, real), *arguments)
        return real(self, *args, **options)

    return open_it


class _Real:
    def __init__(self, path, opened):
        self.open = lambda *args, **options: opened(path, *args, **options)


def test_nothing_at_all(tmp_path, monkeypatch):
    path = tmp_path / "log.bin"
    path.write_bytes(b"some")
    monkeypatch.setattr(Path, "open", opens(path, Failing, 0, errno.EIO))
    with pytest.raises(InputError, match="cannot be read: Input/output error"), windowed(path):
        pass
