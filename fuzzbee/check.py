"""``fuzzbee check``: in which of many logs the autopilot's attitude differs from ours."""

from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import typer

from estimator.errors import InputError
from fuzzbee import options as opt
from fuzzbee.notify import notify

DIFFERS, UNREADABLE = 1, 2


class CheckOptions(NamedTuple):
    """The arguments and options of the verb, in the order of its help."""

    logs: list[Path] = typer.Argument(metavar="LOG...", help="Logs, or folders of them.")
    profile: str = opt.option("imu, adaptive or a TOML file.", default="imu")
    begin: str | None = opt.BEGIN
    end: str | None = opt.END
    as_json: bool = opt.JSON


@opt.command(
    "fuzzbee check flights/",
    "fuzzbee check flights/ --from arm --to disarm",
    "fuzzbee check a.tlog b.bin --json",
)
def check(options: CheckOptions) -> int:
    """Find the logs in which autopilot and estimate differ.

    One line a log, worst first. Ends with 1 if they differ in any, with 2 if one cannot be read.
    """
    import msgspec
    from rich.console import Console
    from rich.progress import track

    from estimator.profile import load_profile
    from fuzzbee.replays.log_check import check_log, line
    from tuning.processes import Pool, available_cores

    profile, window = load_profile(options.profile), opt.time_window(options.begin, options.end)
    paths, work = [*_files(options.logs)], partial(check_log, profile=profile, window=window)
    console = Console(stderr=True)
    bar: Any = {"console": console, "transient": True, "disable": not console.is_terminal}
    with Pool(work, min(len(paths), available_cores())) as pool:
        found = [*track(pool(paths), "checking", len(paths), **bar)]
    found.sort(key=lambda each: each.rank, reverse=True)
    refusals = [f"{each.log}: {each.refused}" for each in found if each.refused]
    faults = [each.fault for each in found if each.fault and options.as_json]
    for text in refusals + faults:
        notify(text)
    if options.as_json:
        print(msgspec.json.encode({"logs": found}).decode())
    else:
        print(*map(line, found), sep="\n")
    if any(each.differences for each in found):
        return DIFFERS
    return UNREADABLE if any(each.fault for each in found) else 0


def _files(given: Iterable[Path]) -> Iterator[Path]:
    """The logs that are named, and those in folders that are; a bag's folder is one log.

    Raises:
        InputError: there is no such file, or a folder without a log.
    """
    from drivers.endpoint import is_bag_folder
    from drivers.logs.open import SUFFIXES

    for path in given:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        if not path.is_dir() or is_bag_folder(path):
            yield path
            continue
        found = [each for each in path.rglob("*") if not is_bag_folder(each.parent)]
        logs = sorted(x for x in found if x.suffix.lower() in SUFFIXES or is_bag_folder(x))
        if not logs:
            raise InputError(f"{path}: no log in this folder ({', '.join(SUFFIXES)})")
        yield from logs
