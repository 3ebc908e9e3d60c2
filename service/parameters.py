"""How a vehicle's profile changes: on request, by retuning, or to fit fuzzbee's own vehicle.

Requests are asked on other threads and answered by the loop's. What is to be published waits for
the next tick.
"""

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from queue import Full, Queue
from typing import Any

from drivers.events import BuiltIn, VehicleId
from drivers.simulation.simulated_vehicle import PROFILES
from estimator.errors import InputError
from estimator.profile import Profile, load_profile, merge_profile
from service.records import Evicted, Message, Output, Replaced, Retuned
from service.vehicle import Vehicle

# Replacements are rare and made by hand; more waiting requests than this are refused.
MAX_PENDING = 16
MOST_PROFILES = 512  # of vehicles that are gone; the one that left first goes
ANSWER_TIMEOUT_S = 2.0

Partial = dict[str, Any]  # of a profile, by its keys
# The last is the reason, if it was retuned without a request
Request = tuple[VehicleId, Partial, str | None]


class ParameterRequests:
    """A mailbox between the threads that ask and the loop that owns the estimators."""

    def __init__(self) -> None:
        self._queue: Queue[tuple[Request, Future[Profile]]] = Queue(MAX_PENDING)
        self._closed = False

    def ask(self, vehicle: VehicleId, partial: Partial, retuned: str | None = None) -> Profile:
        """Have the loop replace a profile; blocks until it did. ``retuned`` is why, if by itself.

        Raises:
            InputError: the loop refused it.
            TimeoutError: the loop is too busy, or not running any more.
        """
        if self._closed:
            raise TimeoutError("the service is ending")
        answer: Future[Profile] = Future()
        try:
            self._queue.put_nowait(((vehicle, partial, retuned), answer))
        except Full:
            raise TimeoutError("too many requests") from None
        try:
            return answer.result(ANSWER_TIMEOUT_S)
        except TimeoutError:
            if not answer.cancel():  # the loop is at work on it, and will soon be done
                return answer.result()
            raise TimeoutError("the service did not answer in time") from None
        except CancelledError:
            raise TimeoutError("the service is ending") from None

    def serve(self, replace: Callable[[VehicleId, Partial, str | None], Profile]) -> None:
        """Answer the waiting requests; called by the loop."""
        while not self._queue.empty():
            request, answer = self._queue.get_nowait()
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(replace(*request))
            except InputError as error:
                answer.set_exception(error)
            except RecursionError:  # nested deep, but not too deep for the parser
                answer.set_exception(InputError("the profile is nested too deep"))
            except Exception as error:  # noqa: BLE001 - one vehicle's profile ends no service
                why = f"the profile cannot be used: {type(error).__name__}: {error}"
                answer.set_exception(InputError(why))

    def close(self) -> None:
        """Refuse all waiting and all later requests; called when the loop has ended."""
        self._closed = True
        while not self._queue.empty():
            _, answer = self._queue.get_nowait()
            answer.cancel()


class ProfileChanges:
    """Changes profiles from ``base``; ``outputs`` are those that no event has caused.

    ``fits_built_in`` is that of :class:`service.pipeline.Pipeline`.
    """

    def __init__(self, base: Profile, *, fits_built_in: bool) -> None:
        self.outputs: list[Output] = []
        self.kept: dict[VehicleId, Profile] = {}  # given to vehicles that are gone
        self._base = base
        self._fits_built_in = fits_built_in

    def replace(self, vehicle: Vehicle, partial: Partial, retuned: str | None) -> Profile:
        """Do :meth:`service.pipeline.Pipeline.replace_profile` for a vehicle that is there."""
        profile = merge_profile(vehicle.profile, partial)
        try:
            vehicle.replace_profile(profile)
        except (ArithmeticError, ValueError, TypeError) as error:
            raise InputError(f"profile update: cannot be used: {error}") from error
        if retuned is not None:
            before = vehicle.publishing.retuned
            vehicle.publishing.retuned = Retuned(1 + (before.count if before else 0), retuned)
        self.report(Replaced(vehicle.address, profile, retuned))
        what = "new parameters" if retuned is None else f"retuned: {retuned}"
        self.outputs += map(Message, vehicle.lines(vehicle.last_arrival_us, what))
        return profile

    def fit(self, vehicle: Vehicle, event: BuiltIn) -> list[Output]:
        """Take the profile that fits fuzzbee's own vehicle, unless another one was asked for."""
        name = PROFILES.get(event.motion)
        if name is None or vehicle.built_in_motion == event.motion:
            return []
        vehicle.built_in_motion = event.motion
        who = f"vehicle {vehicle.name}: fuzzbee's own, motion {event.motion}"
        profile = load_profile(name)
        if not self._fits_built_in:
            fits = vehicle.profile.conditioned == profile.conditioned
            vehicle.alarms.profile_is_unfit = not fits
            return [] if fits else [Message(f"{who}: profile {name} would fit, this one does not")]
        if vehicle.profile != profile:
            self._change(vehicle, profile)
        noise = "" if profile.conditioned else " (signals so noisy that 5 to 10° remain)"
        return [Message(f"{who}, profile {name}{noise}")]

    def note_reboot(self, vehicle: Vehicle) -> None:
        """Another vehicle may have the address of fuzzbee's own now."""
        if vehicle.built_in_motion is None:
            return
        vehicle.built_in_motion = None
        if self._fits_built_in and vehicle.profile != self._base:
            self._change(vehicle, self._base)

    def note_departure(self, vehicle: Vehicle) -> None:
        """Keep the parameters that were set for a vehicle, for when it comes back."""
        if vehicle.profile != self._base and vehicle.built_in_motion is None:
            self.kept[vehicle.address] = vehicle.profile
            if len(self.kept) > MOST_PROFILES:
                del self.kept[next(iter(self.kept))]
        self.outputs.append(Evicted(vehicle.address))

    def report(self, replaced: Replaced) -> None:
        """Publish a vehicle's parameters with the next tick; only the latest count."""
        vehicle, waiting = replaced.vehicle, self.outputs
        kept = [x for x in waiting if not (isinstance(x, Replaced) and x.vehicle == vehicle)]
        self.outputs = [*kept, replaced]

    def _change(self, vehicle: Vehicle, profile: Profile) -> None:
        vehicle.replace_profile(profile)
        vehicle.restart()
        self.report(Replaced(vehicle.address, profile))
