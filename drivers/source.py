"""What a live source is, and the table from address to source."""

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from drivers.endpoint import Endpoint
from drivers.events import Event
from drivers.mavlink.gate import Policy
from drivers.mavlink.recorder import Recorder
from estimator.errors import InputError

if TYPE_CHECKING:
    from drivers.mavlink.link import MavlinkLink
    from drivers.simulation.simulated_vehicle import SimulatedVehicle
    from drivers.simulation.source import SimSource

SIM_MOTION = "paper"  # of sim: without a motion


class EventSource(Protocol):
    """Events that are drained as they arrive in real time, and what was lost of them."""

    @property
    def dropped(self) -> int:
        """Events lost so far because nobody drained them."""

    @property
    def shed(self) -> int:
        """Samples left out so far, since newer ones were there already."""

    @property
    def lost(self) -> int:
        """Datagrams that the system threw away before they could be read."""

    def drain(self, timeout_s: float) -> list[Event]:
        """Events that are there, after waiting at most ``timeout_s`` for the first."""


def require_openable(endpoint: Endpoint) -> None:
    """Find out early whether a source can be opened; a link's port is opened once, for good.

    Raises:
        InputError: a log that is not there or not usable, or a motion that the built-in vehicle
            does not know.
    """
    if endpoint.kind == "sim":
        _simulated(endpoint)
    elif endpoint.kind == "log":
        from drivers.logs.open import open_log

        open_log(Path(endpoint.path))


def open_live(
    endpoint: Endpoint,
    recorder: Recorder | None = None,
    request_rate_hz: float | None = None,
    policy: Policy = Policy(),  # noqa: B008 - immutable
    *,
    references: bool = True,
) -> "MavlinkLink | SimSource":
    """The source for ``endpoint``, to be entered by the caller.

    ``policy`` is which frames a link lets in, and what signs those that it sends. Without
    ``references`` attitudes of others are left out, which spares most of the decoding.

    Raises:
        InputError: the endpoint is a log, or ``sim:`` is to be recorded or asked for a rate.
    """
    if endpoint.kind == "log":
        raise InputError(f"{endpoint} is a log, not a live source")
    if endpoint.kind != "sim":
        from drivers.mavlink.link import MavlinkLink

        options = (endpoint, recorder, request_rate_hz)
        return MavlinkLink(*options, policy=policy, references=references)
    if recorder is not None or request_rate_hz is not None:
        raise InputError("sim: has no MAVLink to record or to ask: start fuzzbee sim --to URL")
    from drivers.simulation.source import SimSource

    return SimSource(_simulated(endpoint))


def _simulated(endpoint: Endpoint) -> "SimulatedVehicle":
    from drivers.simulation.simulated_vehicle import Motion, SimulatedVehicle

    return SimulatedVehicle(seed=0, motion=cast("Motion", endpoint.path or SIM_MOTION))
