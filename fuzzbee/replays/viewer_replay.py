"""A replayed log in the viewer."""

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from drivers.logs.spill_file import blocks
from fuzzbee.replays.trace import VehicleTrace
from service.records import Output, Peer, Published, attitude_record

if TYPE_CHECKING:
    from fuzzbee.replays.comparison import Comparison
    from fuzzbee.viewer.viewer import ViewerSink


def show(viewer: "ViewerSink", trace: VehicleTrace, _: "Comparison") -> None:
    """Draw a trace at the log's own times, with the attitudes by others beside it."""
    for output in outputs(trace):
        with suppress(ConnectionError):  # the viewer was closed: a file may still be wanted
            viewer.handle([output])
    viewer.finish()


def outputs(trace: VehicleTrace) -> Iterator[Output]:
    """What the service would have published at the samples."""
    for rows in blocks(len(trace.attitudes)):
        yield from _outputs(trace, rows)


def _outputs(trace: VehicleTrace, rows: slice) -> Iterator[Output]:
    times_us, arrivals_us = trace.attitudes.times_of(rows), trace.arrivals_us.rows(rows).tolist()
    peers = {source: track.at(times_us) for source, track in trace.references.items()}
    for k, number in enumerate(range(rows.start, rows.stop)):
        attitude = trace.attitudes[number]
        record = attitude_record(
            attitude,
            time_unix_us=arrivals_us[k],
            time_boot_us=attitude.time_us,
            sequence=number,
        )
        if record is None:
            continue
        for source, (attitudes, known) in peers.items():
            if known[k]:
                w, x, y, z = attitudes[k].tolist()
                yield Peer(trace.address, "sim" if source == "sim" else "autopilot", (w, x, y, z))
        yield Published(trace.address, record, trace.samples[number])
