"""Whose a PARAM_VALUE is, and what it says.

A ground station that fetched the parameters as a file writes them to its log under an address
of its own on the vehicle's system (MAVProxy: component 190). They are the autopilot's.
"""

import struct
from collections.abc import Iterable
from typing import Final, NamedTuple

from drivers.events import VehicleId
from drivers.mavlink import constants as mav

INTEGER_PARAMETERS: Final = {
    mav.MAV_PARAM_TYPE_UINT8: "B",
    mav.MAV_PARAM_TYPE_INT8: "b",
    mav.MAV_PARAM_TYPE_UINT16: "H",
    mav.MAV_PARAM_TYPE_INT16: "h",
    mav.MAV_PARAM_TYPE_UINT32: "I",
    mav.MAV_PARAM_TYPE_INT32: "i",
}
MOST_WAITING = 4096  # an autopilot has some 1500; what comes beyond that is not kept


class ParameterValue(NamedTuple):
    """The fields of a PARAM_VALUE."""

    name: str
    raw: float
    kind: int  # MAV_PARAM_TYPE

    def value(self, autopilot: int | None) -> float:
        """The number: PX4 puts an integer's bytes into the float field, ArduPilot its value."""
        kind = INTEGER_PARAMETERS.get(self.kind)
        if autopilot != mav.MAV_AUTOPILOT_PX4 or kind is None:
            return self.raw
        return float(struct.unpack_from("<" + kind, struct.pack("<f", self.raw))[0])


class WaitingParameters:
    """Parameters of systems whose autopilot has not been heard yet; the latest of each name."""

    def __init__(self) -> None:
        self._values: dict[tuple[int, str], ParameterValue] = {}

    def hold(self, system_id: int, value: ParameterValue) -> None:
        """Keep a value until the system's autopilot is known."""
        key = system_id, value.name
        if key in self._values or len(self._values) < MOST_WAITING:
            self._values[key] = value

    def take(self, system_id: int) -> list[ParameterValue]:
        """What was kept for a system, once."""
        keys = [key for key in self._values if key[0] == system_id]
        return [self._values.pop(key) for key in keys]


def owner(sender: VehicleId, autopilots: Iterable[VehicleId]) -> VehicleId | None:
    """Whose parameter it is; None while no autopilot of the sender's system is known.

    Who is an autopilot has parameters of its own. All others on a system speak of its
    autopilot's: of several, the one with the lowest component id, by convention 1.
    """
    if sender.component_id == mav.MAV_COMP_ID_AUTOPILOT1:
        return sender
    known = [each for each in autopilots if each.system_id == sender.system_id]
    return sender if sender in known else min(known, default=None)
