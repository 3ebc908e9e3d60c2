"""A replayed log in the viewer."""

from collections.abc import Iterator
from contextlib import suppress
from math import isnan
from typing import TYPE_CHECKING

from drivers.logs.table import blocks
from estimator.types import Attitude, ImuSample
from fuzzbee.replays.trace import VehicleTrace
from service.publishing import attitude_record
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
        samples = trace.records(ImuSample, rows)
        for k, attitude in enumerate(trace.records(Attitude, rows)):
            record = attitude_record(
                attitude,
                time_unix_us=arrivals_us[k],
                time_boot_us=attitude.time_us,
                sequence=rows.start + k,
            )
            if record is None:
                continue
            for source, attitudes in peers.items():
                w, x, y, z = attitudes[k]
                if not isnan(w):
                    yield Peer(
                        trace.address, "sim" if source == "sim" else "autopilot", (w, x, y, z)
                    )
            yield Published(trace.address, record, samples[k])
