"""The state of one vehicle's estimator: what compiled steps change, and the context beside it."""

from collections.abc import Callable
from functools import partial
from math import cos, pi, remainder, sin
from typing import Any, Concatenate, ParamSpec, TypeVar

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase, after
from estimator.aiding.search import EMPTY_SEARCH, UNKNOWN_RAD
from estimator.aiding.sources.wheels import rolls
from estimator.compilation.compiled import entry_point
from estimator.conditioning.vertical.lowpass import Coefficients
from estimator.filter.alignment import align
from estimator.geometry.earth import PlaceField
from estimator.live import kernel_handle
from estimator.live.aided import conditioned_vectors
from estimator.live.core import (
    UNSEEN,
    Context,
    Core,
    Snapshot,
    in_arrays,
    in_tuples,
    initial_core,
    with_attitude,
    with_turned_compass,
    without_aiding,
)
from estimator.live.published import NO_PULL, Published
from estimator.live.rows import NORTHS
from estimator.live.settings import Settings, settings_of
from estimator.live.situation import (
    AIDED,
    BY_TURNS,
    CONDITIONED,
    PROVEN,
    RAW,
    VOUCHED,
    Situation,
    standing_at,
    unshown_iron,
)
from estimator.profile import Profile
from estimator.types import NEVER_US

P = ParamSpec("P")
R = TypeVar("R")
Advance = Callable[..., tuple[int, int, int, Published]]


class State:
    """A core and its context, under a profile's settings.

    ``core`` and ``context`` are read freely and replaced as a whole, by :meth:`set_core`,
    :meth:`set_context` and :meth:`change_context`: what follows from them is derived there, once.
    The core is in compiled memory from the first step on that is run on it.
    """

    profile: Profile
    settings: Settings  # what the profile comes to for this vehicle and place
    fixed_gain: float | None  # K, if it is not the profile's rules that set it
    context: Context
    handle: Any  # on the core in compiled memory; None before that
    advance: Advance  # see :meth:`ready`
    published: Published | None  # the last sample's output, while that holds
    source: int  # RAW, CONDITIONED or AIDED
    takes_rows: bool  # samples as the profile has them, with only what rows can hold between them
    is_ready: bool  # whether the core's steps know the context

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        self.fixed_gain = fixed_gain
        self.profile = profile
        self.settings = settings_of(profile, fixed_gain)
        self.set_context(Context())
        self.set_core(initial_core(self.settings))

    @property
    def snapshot(self) -> Snapshot:
        """The whole state as a value. Set it to resume from it, under the same profile."""
        return Snapshot(in_tuples(self.core), self.context)

    @snapshot.setter
    def snapshot(self, snapshot: Snapshot) -> None:
        self.context = snapshot.context
        self.settings = self._settings_of(self.profile)
        self.set_context(snapshot.context)
        self.set_core(in_arrays(snapshot.core))

    def set_core(self, core: Core) -> None:
        """Replace what the compiled steps work on."""
        self._core, self.handle = core, None
        self.published, self.is_ready = None, False

    @property
    def core(self) -> Core:
        """What the compiled steps work on, as it is now; its arrays are nobody's to change."""
        return self._core if self.handle is None else self.run(kernel_handle.contents)

    @property
    def time_us(self) -> int:
        """Time of the last sample."""
        return self._core.time_us if self.handle is None else self.run(kernel_handle.status)[0]

    def run(self, kernel: Callable[Concatenate[Any, P], R], *given: P.args, **none: P.kwargs) -> R:
        """Run a kernel of :mod:`estimator.live.kernel_handle` on the core, in compiled memory.

        Compiled code does not check what it is given: it takes plain numbers by their values and
        raises TypeError or ValueError for anything else. Tuples and arrays have to fit.
        """
        if self.handle is None:
            self.handle = kernel_handle.put(self.settings, self._core)
        result: R = entry_point(kernel)(self.handle, *given, **none)
        return result

    def change_context(self, **changes: object) -> None:
        """Replace some fields of the context."""
        self.set_context(self.context._replace(**changes))  # type: ignore[arg-type]

    def set_context(self, context: Context) -> None:
        """Replace the context, and derive what each sample needs from it."""
        self.context = context
        is_raw = context.phase in (Phase.EMPTY, Phase.RAW)
        self.source = AIDED if self.is_aided else RAW if is_raw else CONDITIONED
        is_of_profile = (context.phase is Phase.RAW) != self.settings.conditioned
        self.takes_rows = self.aligned and is_of_profile and not context.reports
        self.is_ready = False

    def ready(self) -> Advance:
        """The step of a sample or of many, on the core; it knows the context."""
        if not self.is_ready:
            self.run(kernel_handle.set_situation, self.situation)
            self.advance = partial(entry_point(kernel_handle.advance), self.handle)
            self.published, self.is_ready = None, True
        return self.advance

    def published_at(self, time_us: int) -> Published:
        """The output at a time, propagated from the last sample."""
        published = self.published
        if published is None or published[0] != time_us:
            self.ready()
            published = self.run(kernel_handle.publish, time_us)
        return published

    @property
    def situation(self) -> Situation:
        """The part of the context that the steps need."""
        now, known, settings = self.context, self.context.compass, self.settings
        is_raw = now.phase is Phase.RAW  # vectors as the sensors show them
        vouched = known.declared_calibrated
        given = self.profile.reference.declination_deg != "position"
        is_true = given or now.last_position.here is not None or not settings.conditioned
        north = NORTHS.index("true" if is_true else "magnetic")
        if self.is_aided:  # either may be wrong; a heading by velocity is proven
            is_contradicted = known.contradicted_since_us is not None
            is_proven = known.confirmed or not now.is_by_field
            vouched = vouched and not is_contradicted
            standing = PROVEN if is_proven and not is_contradicted else BY_TURNS
            if rolls(settings.aiding):
                north = NORTHS.index("true")  # by velocity
        else:
            vouched = known.confirmed if vouched is None else vouched
            standing = BY_TURNS
        return Situation(
            source=self.source,
            standing=VOUCHED if vouched and standing != PROVEN else standing,
            rejected_until_us=NEVER_US if self.is_aided else compass.rejected_until_us(known),
            used_from_us=NEVER_US if is_raw else compass.used_from_us(known),
            knows_north=self.knows_north,
            turned_back=(1.0, 0.0) if is_raw else (cos(known.turned_rad), sin(known.turned_rad)),
            watches_gaps=now.phase in (Phase.SEARCHING, Phase.AIDED),
            north=north,
            north_without={RAW: north, CONDITIONED: 0, AIDED: NORTHS.index("true")}[self.source],
        )

    def use_profile(self, profile: Profile) -> None:
        """Derive the settings from a profile and from what is known of vehicle and place by now.

        For what follows from another call: nothing that wraps :meth:`replace_profile` hears of it.
        """
        settings = self._settings_of(profile)
        now, memory = self.core, self.core.conditioning
        self.profile, self.settings = profile, settings
        self.set_context(self.context)
        vertical = memory.vertical._replace(coefficients=Coefficients())  # of the new parameters
        self.set_core(now._replace(conditioning=memory._replace(vertical=vertical)))
        if not settings.aiding.enabled:
            self.enter(Cause.SWITCH_OFF)

    def _settings_of(self, profile: Profile) -> Settings:
        """A profile's settings for what is known of the vehicle and of its place."""
        vehicle_class = self.context.vehicle_class
        return settings_of(profile, self.fixed_gain, self.place_field, vehicle_class)

    def enter(self, cause: Cause) -> None:
        """Go on to the phase that follows; what does not come along is made blank."""
        before = self.context.phase
        phase = after(before, cause)
        if phase is before:
            return
        if phase is Phase.RAW:
            core = without_aiding(self.settings, self.core)
            self.set_core(core._replace(pull=NO_PULL, seen=UNSEEN, search=EMPTY_SEARCH))
        elif before is Phase.AIDED:
            self.set_core(without_aiding(self.settings, self.core))
        self.change_context(phase=phase)

    def turn_compass(self, turn_rad: float, sigma_rad: float = 0.0) -> None:
        """Read the compass as turned in the vehicle by so much more (rad, about down).

        Without a sigma it is a turn that the aiding has learnt, if it is under way.
        """
        turned_rad = remainder(self.context.compass.turned_rad + turn_rad, 2.0 * pi)
        of = self.settings, self.core, turn_rad, sigma_rad
        self.set_core(with_turned_compass(*of, is_aided=self.is_aided))
        self.contradict_compass(turned_rad=turned_rad)

    def contradict_compass(self, **changes: object) -> None:
        """Note that velocity has shown another heading now, and what else has changed."""
        now_us = self.time_us
        self.change_compass(
            contradicted_us=now_us, confirmed=False, contradicted_since_us=None, **changes
        )

    def change_compass(self, **changes: object) -> None:
        """Replace some of what is known of the compass."""
        known = self.context.compass._replace(**changes)  # type: ignore[arg-type]
        self.change_context(compass=known)

    def align(self) -> None:
        """The first heading ever is alignment, not correction: there was none to correct."""
        if self.settings.aligns:
            now = self.core
            q = align(conditioned_vectors(self.settings.reference, now.seen))
            self.set_core(with_attitude(now, q))

    @property
    def aligned(self) -> bool:
        """Whether there is an attitude yet."""
        return self.context.phase is not Phase.EMPTY

    @property
    def is_aided(self) -> bool:
        """Whether velocity helps."""
        return self.context.phase is Phase.AIDED

    @property
    def compass_is_usable(self) -> bool:
        """Whether there is no evidence against the compass now."""
        known = self.context.compass
        return compass.is_usable(known, self.time_us)

    @property
    def unshown_iron_rad(self) -> float:
        """How far iron may turn a heading by the field, for an uncalibrated compass."""
        memory, settings = self.core.conditioning, self.settings
        if not settings.conditioned:
            return 0.0 if self.compass_is_usable else UNKNOWN_RAD
        place_gauss = settings.reference.place_gauss
        standing = standing_at(self.situation, self.time_us)
        return unshown_iron(settings.conditioning, memory, place_gauss, standing)

    @property
    def place_field(self) -> PlaceField | None:
        """The Earth's field where the vehicle is, None without a position."""
        place = self.context.last_position.here
        return None if place is None else place.field

    @property
    def knows_north(self) -> bool:
        """Whether true north is known: by the profile or by a position."""
        return self.place_field is not None or not self.settings.learns_north
