"""Of frames that have waited for too long, the newest of each sender's streams."""

from collections import Counter
from typing import Any

import numpy as np

from drivers.events import VehicleId
from drivers.mavlink.backlog import WHO_IS_THERE
from drivers.mavlink.imu_messages import IMU_MESSAGES, imu_stream_name, number_at
from drivers.mavlink.messages import MESSAGES
from drivers.mavlink.scanning import COMPONENT, END, LEFT, MESSAGE, PAYLOAD, SYSTEM, Scanned

Rows = Any  # as :mod:`drivers.mavlink.scanning` writes them


Shed = Counter[tuple[VehicleId, str]]
# Of what comes again and again a newer one makes an older one old.
STREAMS = [*IMU_MESSAGES, *MESSAGES, *WHO_IS_THERE]


def newest(scanned: Scanned) -> tuple[Scanned, dict[int, Shed]]:
    """Of what datagrams hold, all but what newer frames make old.

    Nobody makes another peer's frames old, and what is said once (a parameter, an answer) stays.
    Returns what is left, without the datagrams that have lost all, and how many IMU samples are
    left out, by peer.
    """
    rows, counts, come = scanned.rows, np.maximum(scanned.counts, 0), scanned.datagrams
    names, numbers = np.unique(come.peers, return_inverse=True)
    senders = np.repeat(numbers, counts)
    keys = rows[:, SYSTEM] << 40 | rows[:, COMPONENT] << 32 | rows[:, MESSAGE] << 8
    keys |= _numbers(come.data, rows) | senders << 48
    is_in_stream = np.isin(rows[:, MESSAGE], STREAMS)
    keys[~is_in_stream] = -1 - (~is_in_stream).nonzero()[0]
    last, alike = np.unique(keys[::-1], return_index=True, return_counts=True)[1:]
    last = len(rows) - 1 - last
    stays = np.zeros(len(rows), np.bool_)
    stays[last] = True
    shed: dict[int, Shed] = {}
    for k in (alike > 1).nonzero()[0].tolist():
        message, system, component = rows[last[k], (MESSAGE, SYSTEM, COMPONENT)].tolist()
        if message in IMU_MESSAGES:
            name = imu_stream_name(IMU_MESSAGES[message].name, int(keys[last[k]]) & 0xFF)
            of_peer = shed.setdefault(int(names[senders[last[k]]]), Counter())
            of_peer[VehicleId(system, component), name] += int(alike[k]) - 1
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
    return thinned, shed


def said_once(scanned: Scanned, numbers: Rows) -> dict[int, Any]:
    """Which of the rows of these numbers newer ones never make old, by peer."""
    is_said = ~np.isin(scanned.rows[numbers, MESSAGE], STREAMS)
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
