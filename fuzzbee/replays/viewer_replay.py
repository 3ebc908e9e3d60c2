"""A replayed log in the viewer."""

from collections.abc import Iterator
from contextlib import suppress
from math import isnan
from typing import TYPE_CHECKING

from drivers.logs.table import blocks
from fuzzbee.replays.trace import VehicleTrace
from service.records import Output, Peer, Published

if TYPE_CHECKING:
    from fuzzbee.viewer.viewer import ViewerSink


def show(viewer: "ViewerSink", trace: VehicleTrace) -> None:
    """Draw a trace at the log's own times, with the attitudes by others beside it."""
    for output in outputs(trace):
        if not viewer.stream.is_wanted:  # a full disk: it is said at the end
            break
        with suppress(ConnectionError):  # the viewer was closed: a file may still be wanted
            viewer.handle([output])
    viewer.finish()


def outputs(trace: VehicleTrace) -> Iterator[Output]:
    """What the service would have published at the samples."""
    for rows in blocks(len(trace)):
        times_us, arrivals_us = trace["time_us"][rows], trace["arrival_us"][rows].tolist()
        peers = {name: track.at(times_us).tolist() for name, track in trace.references.items()}
        for k, (record, sample) in enumerate(trace.published(rows, arrivals_us)):
            if record is None:
                continue
            for source, attitudes in peers.items():
                w, x, y, z = attitudes[k]
                if not isnan(w):
                    is_truth = source == "sim"
                    yield Peer(trace.address, "sim" if is_truth else "autopilot", (w, x, y, z))
            yield Published(trace.address, record, sample)
