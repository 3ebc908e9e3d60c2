"""``fuzzbee check``: in which of many logs the autopilot's attitude differs from ours."""

import os
import signal
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee.options import Json, command, examples, option

DIFFERS, UNREADABLE = 1, 2
_LOGS = "Logs, or folders of them."

EPILOG = examples(
    "fuzzbee check flights/",
    "fuzzbee check a.tlog b.bin --json",
)


class CheckOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help=_LOGS)]
    profile: Annotated[str, option("imu, adaptive or a TOML file.")] = "imu"
    as_json: Json = False


class Checked(NamedTuple):
    """What one log says: its differences, worst first in order; or why it cannot be read."""

    log: str
    agreement: dict[str, int]
    differences: list[dict[str, Any]]
    fault: str

    @property
    def rank(self) -> tuple[bool, float]:
        """The larger, the worse."""
        seconds = sum(each["end_s"] - each["begin_s"] for each in self.differences)
        return bool(self.differences), seconds


@command
def check(options: CheckOptions) -> None:
    """Go over logs, and tell in which the autopilot's attitude is not to be believed, or ours.

    One line a log, worst first. Ends with 1 if they differ in any, with 2 if one cannot be read.
    """
    import msgspec

    from estimator.profile import load_profile

    load_profile(options.profile)  # refused before the work
    paths = [*_files(options.logs)]
    found = sorted(_checked(paths, options.profile), key=lambda each: each.rank, reverse=True)
    if options.as_json:
        print(msgspec.json.encode({"logs": [each._asdict() for each in found]}).decode())
    else:
        for each in found:
            print(_line(each))
    if any(each.differences for each in found):
        raise typer.Exit(DIFFERS)
    if any(each.fault for each in found):
        raise typer.Exit(UNREADABLE)


def _files(given: Iterable[Path]) -> Iterator[Path]:
    """The logs that are named, and those in folders that are.

    Raises:
        InputError: there is no such file, or a folder without a log.
    """
    from drivers.logs.open import SUFFIXES

    for path in given:
        if not path.is_dir():
            if not path.exists():
                raise InputError(f"{path}: no such file")
            yield path
            continue
        inside = sorted(each for each in path.rglob("*") if each.suffix.lower() in SUFFIXES)
        if not inside:
            raise InputError(f"{path}: no log in this folder ({', '.join(SUFFIXES)})")
        yield from inside


def _checked(paths: list[Path], profile: str) -> list[Checked]:
    """All of them, on all cores, with a bar where standard error is a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    from fuzzbee.replays.log_check import check_log

    console = Console(stderr=True)
    workers = min(len(paths), os.cpu_count() or 1)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("checking", total=len(paths))
        with _interrupts_held():
            pool = _pool(workers)  # a process that keeps account of what is shared comes with it
        if pool is None:
            return [check_log(path, profile) for path in bar.track(paths, task_id=task)]
        with pool:
            with _interrupts_held():
                waiting = [pool.submit(check_log, path, profile) for path in paths]
            try:
                for _ in as_completed(waiting):
                    bar.advance(task)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                for worker in active_children():
                    worker.terminate()
                raise
            return [each.result() for each in waiting]


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """A terminal interrupts nothing that is started meanwhile: we end it, without a traceback."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _pool(workers: int) -> ProcessPoolExecutor | None:
    """None where one process is enough, or the system has nothing that several could share."""
    try:
        return None if workers == 1 else ProcessPoolExecutor(workers, get_context("spawn"))
    except OSError:  # /dev/shm is read-only or full
        return None


def _line(checked: Checked) -> str:
    from fuzzbee.replays.table import spoken
    from fuzzbee.say import printable

    name = printable(checked.log)
    if checked.fault:
        return f"{name}: not checked: {printable(checked.fault)}"
    if not checked.differences:
        looks = sum(checked.agreement.values())
        if not looks:
            return f"{name}: no attitude of an autopilot to compare with"
        share = checked.agreement.get("agrees", 0) / looks
        return f"{name}: no difference; known to agree for {share:.0%} of the time"
    worst = max(checked.differences, key=lambda each: each["end_s"] - each["begin_s"])
    more = len(checked.differences) - 1
    return f"{name}: differs, {spoken(worst)}" + (f" (and {more} more)" if more else "")
