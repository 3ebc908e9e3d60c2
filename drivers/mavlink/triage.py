"""Of frames that have waited for too long, the newest of each sender's streams."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from drivers.events import VehicleId
from drivers.mavlink.backlog import STREAMS
from drivers.mavlink.imu_messages import IMU_MESSAGES, imu_stream_name, number_at
from drivers.mavlink.scanning import COMPONENT, END, LEFT, MESSAGE, PAYLOAD, SYSTEM, Scanned

Rows = Any  # as :mod:`drivers.mavlink.scanning` writes them


class Old(NamedTuple):
    """So many samples of a peer's stream are left out."""

    peer: int
    vehicle: VehicleId
    stream: str
    samples: int


def newest(scanned: Scanned) -> tuple[Scanned, list[Old]]:
    """Of what datagrams hold, all but what newer frames make old.

    Nobody makes another peer's frames old, and what is said once (a parameter, an answer) stays.
    Returns what is left, without the datagrams that have lost all, and the IMU samples that are
    left out.
    """
    rows, counts, come = scanned.rows, np.maximum(scanned.counts, 0), scanned.datagrams
    names, numbers = np.unique(come.peers, return_inverse=True)
    senders = np.repeat(numbers, counts)
    keys = rows[:, SYSTEM] << 40 | rows[:, COMPONENT] << 32 | rows[:, MESSAGE] << 8
    keys |= _numbers(come.data, rows) | senders << 48
    is_in_stream = np.isin(rows[:, MESSAGE], [*STREAMS])
    keys[~is_in_stream] = -1 - (~is_in_stream).nonzero()[0]
    last, alike = np.unique(keys[::-1], return_index=True, return_counts=True)[1:]
    last = len(rows) - 1 - last
    stays = np.zeros(len(rows), np.bool_)
    stays[last] = True
    is_old = (alike > 1) & np.isin(rows[last, MESSAGE], [*IMU_MESSAGES])
    of = rows[last[is_old]]
    columns = (
        *(names[senders[last[is_old]]], of[:, SYSTEM], of[:, COMPONENT], of[:, MESSAGE]),
        *(keys[last[is_old]] & 0xFF, alike[is_old] - 1),
    )
    old = [
        Old(peer, VehicleId(system, component), _stream_name(message, imu), samples)
        for peer, system, component, message, imu, samples in zip(
            *(each.tolist() for each in columns), strict=True
        )
    ]
    left = np.bincount(np.repeat(np.arange(len(counts)), counts)[stays], minlength=len(counts))
    is_left = scanned.counts == LEFT
    kept = (left > 0) | is_left
    left = left[kept]
    thinned = Scanned(
        come.kept(kept),
        np.where(is_left[kept], LEFT, left),
        left.cumsum() - left,
        scanned.senders[kept],
        rows[stays],
    )
    return thinned, old


@cache
def _stream_name(message: int, imu: int) -> str:
    return imu_stream_name(IMU_MESSAGES[message].name, imu)


def said_once(scanned: Scanned, numbers: Rows) -> dict[int, Any]:
    """Which of the rows of these numbers newer ones never make old, by peer."""
    is_said = ~np.isin(scanned.rows[numbers, MESSAGE], [*STREAMS])
    peers = np.repeat(scanned.datagrams.peers, np.maximum(scanned.counts, 0))[numbers]
    return {
        peer: (is_said & (peers == peer)).nonzero()[0]
        for peer in np.unique(peers[is_said]).tolist()
    }


def _numbers(data: Any, rows: Rows) -> Any:
    """The number of the IMU that each frame tells, or 0."""
    numbers = np.zeros(len(rows), np.int64)
    for message in IMU_MESSAGES:
        at = number_at(message)
        if at is None:
            continue
        has_it = (rows[:, MESSAGE] == message) & (rows[:, PAYLOAD] + at < rows[:, END])
        numbers[has_it] = data[rows[has_it, PAYLOAD] + at]
    return numbers
