"""Whose frames are let in for some seconds without another look at who sends them.

Gate, claims, reader and backlog judge a packet in Python, one after the other. Of a peer that all
of them have let in, with the frames of one address, they would say the same of the next packet: it
has a lease, and compiled code lets pass what holds nothing but sound frames of that address.
"""

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from drivers.mavlink.claims import CLAIM_S
from drivers.mavlink.framing import ADDRESSES
from drivers.mavlink.scanning import BEGIN, LEFT, STOP, Scanned
from drivers.mavlink.usual_kinds import ARRIVAL, BATCH_COLUMNS, FATE, NUMBER, WAITING
from drivers.mavlink.usual_kinds import BEGIN as FRAME_BEGIN
from drivers.mavlink.usual_kinds import STOP as FRAME_STOP
from estimator.compilation.compiled import compiled, inlined, is_compiled_code
from estimator.compilation.direct import direct, types_of

Array = Any  # numba ships no types
NOBODY = -1
LONGEST_US = int(1e6 * CLAIM_S)  # beyond that the clock was set back
# What becomes of a datagram: it is judged; it passes; it would, but waits behind others.
JUDGED, PASSES, WAITS = 0, 1, 2
# So many peers may have sent something else within a look; beyond that nobody passes.
MOST_ODD = 16
# A multiplier that lays neighbouring numbers of 16 bits far from each other (2**16 / 1.618).
SPREADING = 40_503


@compiled
def pass_by(
    come: tuple[Array, Array, Array, Array],
    rows: Array,
    leases: tuple[Array, Array, Array],
    waiting_in: Array,
    turn: int,
    has_come: Array,
    done: Array,
    passing: Array,
) -> int:
    """Find the datagrams that pass; returns how many frames they have.

    ``come`` are the datagrams' counts of rows, senders, peers and arrivals; ``leases`` the arrays
    of :class:`Leases`. ``waiting_in`` has, by address, the ``turn`` in which some of its frames
    did not pass: what comes behind those waits, too, as that of who ``has_come`` not yet. ``done``
    tells what becomes of each. ``passing`` gets the frames of those that pass, as a batch has them.
    """
    counts, senders, peers, arrivals_us = come
    holders, until_us, heard_us = leases
    odd, odds = np.zeros(MOST_ODD, np.int64), 0
    row, n = 0, 0
    for k in range(len(counts)):
        done[k] = JUDGED
        sender, peer, arrival_us = senders[k], peers[k], arrivals_us[k]
        if counts[k] == LEFT or sender == 0:
            if odds < MOST_ODD:
                odd[odds] = peer
            odds += 1
            continue
        begin, row = row, row + counts[k]
        is_held = holders[sender] == peer and 0 < until_us[sender] - arrival_us <= LONGEST_US
        if not is_held or is_among(odd, odds, peer):
            waiting_in[sender] = turn
            continue
        heard_us[sender] = max(heard_us[sender], arrival_us)
        if waiting_in[sender] == turn or not has_come[sender]:
            done[k], waiting_in[sender] = WAITS, turn
            continue
        done[k] = PASSES
        for i in range(begin, row):
            passing[n, ARRIVAL], passing[n, FATE], passing[n, NUMBER] = arrival_us, WAITING, i
            passing[n, FRAME_BEGIN], passing[n, FRAME_STOP] = rows[i, BEGIN], rows[i, STOP]
            n += 1
    return n


@inlined
def is_among(odd: Array, odds: int, peer: int) -> bool:
    """Whether a peer is one of those, or there are too many to say."""
    is_odd = odds > MOST_ODD
    for k in range(min(odds, MOST_ODD)):
        is_odd = is_odd or odd[k] == peer
    return is_odd


class Leases:
    """By address: the peer that has the lease, and until when (us, by the arrivals' clock)."""

    def __init__(self) -> None:
        self._holders = np.full(ADDRESSES, NOBODY, np.int64)
        self._until_us = np.zeros(ADDRESSES, np.int64)
        self._heard_us = np.zeros(ADDRESSES, np.int64)
        self._names: dict[int, str] = {}
        self._held: set[int] = set()  # peers that may have one
        self._waiting_in = np.zeros(ADDRESSES, np.int64)
        self._turn = 0
        self._pass = direct(pass_by, argument_types()) if is_compiled_code() else None

    def passing(
        self, scanned: Scanned, waiting: Iterable[int], has_come: Array
    ) -> tuple[Array, Array]:
        """What becomes of the datagrams, and the frames of those that pass, as a batch has them.

        Those of the addresses that are ``waiting`` come behind what waits, as those that have not
        ``has_come``.
        """
        self._turn += 1
        for address in waiting:
            self._waiting_in[address] = self._turn
        come = scanned.datagrams
        done = np.empty(len(scanned.counts), np.int64)
        passing = np.empty((len(scanned.rows), BATCH_COLUMNS), np.int64)
        assert self._pass is not None
        n = self._pass(
            (scanned.counts, scanned.senders, come.peers, come.arrivals_us),
            scanned.rows,
            (self._holders, self._until_us, self._heard_us),
            self._waiting_in,
            self._turn,
            has_come,
            done,
            passing,
        )
        return done, passing[:n]

    def grant(self, address: int, peer: int, name: str, begin_us: int, longest_us: int) -> None:
        """Frames of that address pass that come from a peer, of that number and name.

        For half of ``longest_us`` to all of it, by address: of hundreds that one peer brings, some
        are judged now and then, and never all at one look.
        """
        if self._holders[address] != peer:
            self._heard_us[address] = 0
        left_out = address * SPREADING % ADDRESSES / (2 * ADDRESSES)
        self._holders[address] = peer
        self._until_us[address] = begin_us + int(longest_us * (1.0 - left_out))
        self._names[address] = name
        self._held.add(peer)

    def heard_us(self, address: int, name: str) -> int:
        """When frames passed last that a peer had a lease for; 0 if none did."""
        return int(self._heard_us[address]) if self._names.get(address) == name else 0

    def end(self, peer: int | None = None) -> None:
        """The leases of a peer end, or all."""
        if peer is None:
            self._held.clear()
            self._until_us[:] = 0
        elif peer in self._held:
            self._held.discard(peer)
            self._until_us[self._holders == peer] = 0


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`pass_by` is called with."""
    numbers, table = np.zeros(0, np.int64), np.zeros((0, 0), np.int64)
    flags = np.zeros(0, np.bool_)
    come, leases = (numbers,) * 4, (numbers,) * 3
    return types_of(come, table, leases, numbers, 0, flags, numbers, table)
