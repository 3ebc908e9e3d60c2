"""Opens a log by what it is: the content decides, not the name."""

import re
import stat
from collections.abc import Iterator
from pathlib import Path

from drivers.endpoint import FORMS, TABLES, is_bag_folder
from drivers.events import Event, Imu
from drivers.logs.bag import SUFFIXES as BAG_SUFFIXES
from drivers.logs.bag import Bag
from drivers.logs.csv_text import HEAD_SIZE, UTF_16, csv_text
from drivers.logs.log_file import LogFile
from drivers.logs.tlog import Tlog
from drivers.logs.ulog_format import MAGIC as ULOG_MAGIC
from estimator.errors import InputError
from estimator.profile import SHIPPED

# Of what is looked for in a folder
SUFFIXES = (".tlog", ".log", ".bin", ".ulg", ".csv", *BAG_SUFFIXES)
DATAFLASH_FORMAT = re.compile(rb"\xa3\x95\x80")  # head of a FMT message, which comes first
DATAFLASH_TEXT = re.compile(rb"^FMT, ?\d+, ?\d+, ?", re.MULTILINE)
COMPRESSED = (b"\x1f\x8b", b"PK\x03\x04", b"7z\xbc\xaf", b"\xfd7zXZ", b"BZh", b"\x28\xb5\x2f\xfd")
BAG_MAGIC = (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V")


def open_log(path: Path, columns: Path | None = None) -> LogFile:
    """The log in ``path``: telemetry log, DataFlash, ULog, a bag, or a table as text.

    ``columns`` is the TOML file that describes a table's columns.

    Raises:
        InputError: if there is no such file, or it is empty, unreadable or no
            log known here; the message names the file and what is wrong.
    """
    if is_bag_folder(path):
        return Bag(path)
    head = _head(path)
    if head.startswith(BAG_MAGIC):
        if path.suffix.lower() not in BAG_SUFFIXES:
            raise InputError(f"{path}: a bag: its name should end in {', '.join(BAG_SUFFIXES)}")
        return Bag(path)
    if head.startswith(ULOG_MAGIC):
        from drivers.logs.ulog import Ulog

        return Ulog(path)
    if DATAFLASH_FORMAT.match(head):
        from drivers.logs.dataflash import Dataflash

        return Dataflash(path)
    if DATAFLASH_TEXT.search(head[:4096]):
        raise InputError(f"{path}: a DataFlash log as text, use the .bin it was made from")
    if head.startswith(COMPRESSED):
        raise InputError(f"{path}: a compressed file, unpack it first")
    is_text = b"\0" not in head or head.startswith(UTF_16)
    if is_text and (path.suffix.lower() in TABLES or csv_text(head) is not None):
        from drivers.logs.csv_log import CsvLog

        return CsvLog(path, columns)
    if columns is not None:
        raise InputError(f"{columns}: describes the columns of a table, but {path} is none")
    return Tlog(path)


def imu_events(log: LogFile) -> Iterator[Event]:
    """The log's events, insisting on IMU data.

    Raises:
        InputError: at the end, if there was no IMU sample.
    """
    found = False
    for event in log:
        found = found or isinstance(event, Imu)
        yield event
    if not found:
        raise InputError(f"{log.path}: no usable IMU message in this log")


def _meant(name: str) -> str:
    """What somebody may have meant who gives this for a log."""
    if name in SHIPPED:
        return f" (the profile is --profile {name})"
    kind = name.partition(":")[0]
    is_link = ":" in name and any(kind in form.names for form in FORMS)
    return " (a live source is for fuzzbee run)" if is_link else ""


def _head(path: Path) -> bytes:
    """The file's first bytes; a pipe would block, and a device may never end."""
    try:
        about = path.stat()
        if stat.S_ISDIR(about.st_mode):
            raise InputError(f"{path}: a folder, not a log file")
        if not stat.S_ISREG(about.st_mode):
            raise InputError(f"{path}: not a file but a pipe, a socket or a device")
        if about.st_size == 0:  # some of the kernel's would block
            raise InputError(f"{path}: the file is empty")
        with path.open("rb") as file:
            return file.read(HEAD_SIZE)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file{_meant(str(path))}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
