"""A replayed log in the viewer."""

from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from fuzzbee.replays.trace import VehicleTrace
from service.attitude_record import attitude_record
from service.records import Output, Peer, Published

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
    times_us = trace.times_us
    peers = {
        source: track.at(times_us)
        for source, track in trace.references.items()
        if track.message is not None
    }
    for number, attitude in enumerate(trace.attitudes):
        record = attitude_record(
            attitude,
            time_unix_us=trace.arrivals_us[number],
            time_boot_us=attitude.time_us,
            sequence=number,
        )
        if record is None:
            continue
        for source, (attitudes, known) in peers.items():
            if known[number]:
                w, x, y, z = attitudes[number].tolist()
                yield Peer(trace.address, "sim" if source == "sim" else "autopilot", (w, x, y, z))
        yield Published(trace.address, record, trace.samples[number])
