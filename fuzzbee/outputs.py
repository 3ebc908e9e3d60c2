"""What ``run`` sends and shows beside its Zenoh keys: the options, and the sinks they open."""

import os
from collections import namedtuple
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from drivers.endpoint import TABLES, columns_beside
from estimator.errors import InputError
from fuzzbee.options import of_recording, of_showing, require_extra
from fuzzbee.sinks import SINKS, Opening

if TYPE_CHECKING:
    import zenoh

    from fuzzbee.viewer.stream import ViewerOptions
    from fuzzbee.viewer.viewer import ViewerSink
    from service.sinks.sink import Sink

_VIEW = "Show it in Rerun: a window, or a page for a browser (extra: viewer)."
_RRD = "Save what the viewer shows, for rerun FILE (extra: viewer)."
View = Annotated[str | None, of_showing(_VIEW, metavar="window|web")]
Rrd = Annotated[str | None, of_recording(_RRD, metavar="FILE")]


def _options_of_sinks() -> Any:
    """A named tuple of the options of all sinks and of the viewer."""
    options = {name: kind for entry in SINKS for name, kind in entry.options.items()}
    options |= {"view": (View, None), "rrd": (Rrd, None)}
    new: Any = namedtuple  # noqa: PYI024 - the names are those of a table
    form = new("Options", options, defaults=[default for _, default in options.values()])
    form.__annotations__ = {name: kind for name, (kind, _) in options.items()}
    return form


class OutputOptions(_options_of_sinks()):  # type: ignore[misc] # its fields are the table's
    """What was asked for: a field for each option of :data:`fuzzbee.sinks.SINKS`, and two more."""

    __slots__ = ()


def open_outputs(
    options: OutputOptions, session: "zenoh.Session | None", prefix: str, rate_hz: float
) -> "Iterator[Sink]":
    """Open the sinks that were asked for, one after the other."""
    for entry in SINKS:
        if entry.is_wanted(options):
            sink = entry.open(Opening(options._asdict(), session, prefix, rate_hz))
            if sink is not None:
                yield sink
    viewer = open_viewer(options.view, options.rrd, live=True)
    if viewer is not None:
        yield viewer


def open_viewer(view: str | None, rrd: str | None, *, live: bool = False) -> "ViewerSink | None":
    """The viewer that was asked for, if any."""
    options = viewer_options(view, rrd)
    if options is None:
        return None
    from fuzzbee.viewer.viewer import ViewerSink

    return ViewerSink(options._replace(live=live))


def viewer_options(view: str | None, rrd: str | None) -> "ViewerOptions | None":
    """The viewer that the options ask for; None if they ask for none."""
    if view is None and rrd is None:
        return None
    if view not in (None, "window", "web"):
        raise InputError(f"--view {view}: should be window or web")
    require_extra("rerun", "the viewer", "viewer")
    from fuzzbee.viewer.stream import ViewerOptions

    return ViewerOptions(view, rrd)


def require_own_files(
    outputs: Iterable[tuple[str, object]], inputs: Iterable[str | Path | None]
) -> None:
    """Refuse a file to be written, by its option if given, that is an input or another output.

    A link leads to the same file, by whatever name; a bag is a folder, and what a table's columns
    are stands beside it.
    """
    taken = [Path(each) for each in inputs if each is not None]
    taken += [columns_beside(each) for each in taken if each.suffix.lower() in TABLES]
    folders = {os.path.realpath(each): each for each in taken if os.path.isdir(each)}  # noqa: PTH112
    for option_name, file in outputs:
        if file is None:
            continue
        path = Path(str(file))
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():
            raise InputError(f"{option_name} {path}: there is no such folder")
        for other in taken:
            if _are_same(path, other):
                raise InputError(f"{option_name} {path}: is also {other}")
        for above in (folder, *folder.parents):
            if (within := folders.get(str(above))) is not None:
                raise InputError(f"{option_name} {path}: is within {within}")
        taken.append(path)


def _are_same(one: Path, other: Path) -> bool:
    with suppress(OSError):  # one of them is not there yet
        if one.samefile(other):
            return one.is_file()  # a device takes anything
    return os.path.realpath(one) == os.path.realpath(other)
