"""Tuning on recorded flights: the paper's cost over segments that start with a large error.

The reference is the truth of a simulation or the autopilot's attitude, the
better one that a log has. A log with neither is tuned on the prediction of its
own vectors up to a second ahead. Where a log has no magnetic field only the
inclination counts.
"""

from dataclasses import dataclass
from functools import cached_property
from math import radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.conditioning.types import ConditioningParams
from estimator.errors import InputError
from estimator.filter.alignment import align
from estimator.filter.memberships import NAMES
from estimator.filter.observation import weighted_vectors
from estimator.geometry.quaternion import exp, multiply, scale
from estimator.live.settings import Settings, settings_of
from estimator.profile import Profile
from estimator.types import Quaternion, Vec3
from tuning import log_kernel
from tuning.log_dataset import LogData
from tuning.log_kernel import Prepared, Recorded
from tuning.objective import Scores, require_fuzzy_gain
from tuning.parameters import CONDITIONED_GROUPS, EMPTY, space_of
from tuning.segments import Segment, segments, split, weights
from tuning.space import Space

Array = NDArray[np.float64]

# Next to the unstable equilibrium, as the paper starts: e = 0.992.
WRONG_START_RAD = radians(170.0)
WRONG_START_AXIS: Vec3 = (3**-0.5, 3**-0.5, 3**-0.5)
# A prediction begins anew from the estimate this often.
PREDICTION_S = 1.0

# Below this rate the gyroscope is aliased, and the first second has only a handful of samples: they
# cannot show which memberships are better, as the paper's are made for 100 Hz.
MEMBERSHIP_RATE_HZ = 10.0

CONDITIONING = np.dtype(
    [
        (name, np.bool_ if isinstance(default, bool) else np.float64)
        for name, default in ConditioningParams._field_defaults.items()
    ]
)


def default_groups(rate_hz: float) -> tuple[str, ...]:
    """The groups of parameters that a log of that rate can tune."""
    return ("membership",) if rate_hz >= MEMBERSHIP_RATE_HZ else ("confidence", "conditioning")


@dataclass(frozen=True)
class LogObjective:
    """Mean cost of the segments.

    ``prepared`` holds the conditioned vectors that all candidates share; it is None where the
    conditioning itself is tuned, and each candidate conditions the samples anew.
    """

    names: tuple[str, ...]
    conditioning: ConditioningParams
    base_row: Array
    data: Recorded
    prepared: Prepared | None

    def costs(self, values: Array) -> Array:
        """See :class:`tuning.objective.Objective`."""
        return self._costs(
            values, log_kernel.parallel_prepared_costs, log_kernel.parallel_conditioned_costs
        )

    def serial_costs(self, values: Array) -> Array:
        """See :class:`tuning.objective.Objective`."""
        return self._costs(
            values, log_kernel.serial_prepared_costs, log_kernel.serial_conditioned_costs
        )

    def errors(self) -> Array:
        """e (N,) at each sample with the values of the base profile, on shared vectors."""
        assert self.prepared is not None
        errors: Array = log_kernel.prepared_errors(self.base_row, self.prepared, self.data)
        return errors

    def _costs(self, values: Array, on_prepared: Any, on_raw: Any) -> Array:
        rows = self._rows(values)
        costs: Array
        if self.prepared is not None:
            costs = on_prepared(rows, self.prepared, self.data)
        else:
            costs = on_raw(rows, self._records(values), self.data)
        return costs

    def _rows(self, values: Array) -> Array:
        rows = np.tile(self.base_row, (len(values), 1))
        for i, name in enumerate(self.names):
            if name in ROW:
                rows[:, ROW[name]] = values[:, i]
        return rows

    def _records(self, values: Array) -> Any:
        """One record of conditioning parameters a candidate: a kernel reads its fields by name."""
        records = np.array([tuple(self.conditioning)] * len(values), dtype=CONDITIONING)
        for i, name in enumerate(self.names):
            section, _, key = name.rpartition(".")
            if section == "conditioning":
                records[key] = values[:, i]
        return records


ROW = {name: i for i, name in enumerate(NAMES)} | {
    "filter.rate_time_constant_s": log_kernel.TAU,
    "confidence.gravity": log_kernel.S_GRAVITY,
    "confidence.magnetic": log_kernel.S_MAGNETIC,
    "confidence.cross": log_kernel.S_CROSS,
}


@dataclass(frozen=True)
class LogTask:
    """Tuning of ``groups`` on logs.

    Raises:
        InputError: on use, if a log has fewer than two segments, or the base
            does not condition its vectors, or has no fuzzy gain whose memberships could be tuned.
    """

    base: Profile
    groups: tuple[str, ...]
    logs: tuple[LogData, ...]

    @cached_property
    def space(self) -> Space:
        """The parameters that are tuned."""
        return space_of(self.groups, CONDITIONED_GROUPS)

    @cached_property
    def objective(self) -> LogObjective:
        """Mean cost of the segments that are not held out."""
        return self._objective(self.base, self.space, self._tuning_segments)

    def score(self, profile: Profile) -> Scores:
        """Mean cost of the tuning and of the held-out segments, everything computed anew."""
        nothing = np.empty((1, 0))
        found = [
            self._objective(profile, EMPTY, chosen).serial_costs(nothing)[0]
            for chosen in (self._tuning_segments, self._held_out_segments)
        ]
        return Scores(float(found[0]), float(found[1]))

    def held_out_errors(self, profile: Profile) -> list[tuple[Array, Array]]:
        """Times (n,) since its start and e (n,) of each held-out segment."""
        objective = self._objective(profile, EMPTY, self._held_out_segments)
        errors = objective.errors()
        found = []
        begin = 0
        for log, picked in zip(self.logs, self._held_out_segments, strict=True):
            for first, last in picked:
                end = begin + last - first + 1
                time_s = log.time_s[first : last + 1] - log.time_s[first]
                found.append((time_s, errors[begin:end]))
                begin = end
        return found

    @cached_property
    def _split(self) -> list[tuple[list[Segment], list[Segment]]]:
        splits = [split(segments(log)) for log in self.logs]
        for log, (tuning, held_out) in zip(self.logs, splits, strict=True):
            if not tuning or not held_out:
                raise InputError(
                    f"{log.name}: at least two stretches of 14 s without gaps and with a "
                    f"reference are needed, found {len(tuning) + len(held_out)}"
                )
        return splits

    @property
    def _tuning_segments(self) -> list[list[Segment]]:
        return [tuning for tuning, _ in self._split]

    @property
    def _held_out_segments(self) -> list[list[Segment]]:
        return [held_out for _, held_out in self._split]

    def segment_counts(self) -> tuple[int, int]:
        """How many segments are searched on, and how many are held out."""
        return sum(map(len, self._tuning_segments)), sum(map(len, self._held_out_segments))

    def _objective(
        self, profile: Profile, space: Space, chosen: list[list[Segment]]
    ) -> LogObjective:
        if not profile.conditioned:
            raise InputError("base profile: logs are tuned with conditioning.enabled = true")
        if "k1" in space.names:
            require_fuzzy_gain(profile)
        settings = settings_of(profile)
        row = _row(settings)
        total = sum(map(len, chosen))
        parts = [
            _kernel_data(profile, log, picked, total)
            for log, picked in zip(self.logs, chosen, strict=True)
        ]
        columns: Any = (np.concatenate(column) for column in zip(*parts, strict=True))
        data = Recorded(*columns)
        if any(name.startswith("conditioning.") for name in space.names):
            return LogObjective(
                names=space.names,
                conditioning=settings.conditioning,
                base_row=row,
                data=data,
                prepared=None,
            )
        prepared = _prepare(settings, data)
        kept = _inside_segments(chosen, [len(log.time_s) for log in self.logs])
        return LogObjective(
            names=space.names,
            conditioning=settings.conditioning,
            base_row=row,
            data=_select(data, kept),
            prepared=_select(prepared, kept),
        )


def _row(settings: Settings) -> Array:
    """A candidate's row with the profile's own values."""
    chosen, reference = settings.filter, settings.reference
    row = np.empty(log_kernel.COLUMNS)
    row[: len(NAMES)] = chosen.memberships
    row[log_kernel.TAU] = chosen.rate_time_constant_s
    row[log_kernel.S_GRAVITY] = reference.s_gravity
    row[log_kernel.S_MAGNETIC] = reference.s_magnetic
    row[log_kernel.S_CROSS] = reference.s_cross
    row[log_kernel.GAMMA] = chosen.gamma
    row[log_kernel.BIAS_BOUND] = chosen.bias_bound_rad_s
    row[log_kernel.EULER_STEP_MAX] = chosen.euler_step_max_s
    row[log_kernel.GRAVITY_NED : log_kernel.GRAVITY_NED + 3] = reference.gravity_ned
    row[log_kernel.GAIN_IS_FIXED] = chosen.gain_is_fixed
    row[log_kernel.FIXED_GAIN] = chosen.fixed_gain
    row[log_kernel.GAIN_KNOWS_NOISE] = chosen.gain_knows_noise
    return row


def _select(columns: Any, kept: NDArray[np.bool_]) -> Any:
    """The same columns with the ``kept`` samples alone."""
    return columns._make(np.ascontiguousarray(column[kept]) for column in columns)


def _inside_segments(chosen: list[list[Segment]], lengths: list[int]) -> NDArray[np.bool_]:
    """Which samples lie in a segment: on shared vectors the others need not be computed."""
    kept = np.zeros(sum(lengths), dtype=bool)
    offset = 0
    for picked, length in zip(chosen, lengths, strict=True):
        for first, last in picked:
            kept[offset + first : offset + last + 1] = True
        offset += length
    return kept


def _prepare(settings: Settings, data: Recorded) -> Prepared:
    record = np.array([tuple(settings.conditioning)], dtype=CONDITIONING)[0]
    prepared: Prepared = log_kernel.prepare(record, data)
    return prepared


def _kernel_data(profile: Profile, log: LogData, chosen: list[Segment], total: int) -> Recorded:
    settings = settings_of(profile, declination_rad=log.declination_rad)
    n = len(log.time_s)
    dt_s = np.diff(log.time_s, prepend=log.time_s[0])
    what = np.zeros(n, dtype=np.int64)
    what[log.restart] |= log_kernel.RESTART
    dt_s[log.restart] = 0.0
    if log.reference == "none":
        what |= log_kernel.PREDICTION
    elif not log.has_field:
        what |= log_kernel.INCLINATION
    data = Recorded(
        what=what,
        dt_s=dt_s,
        gyr_rad_s=log.gyr_rad_s,
        acc_m_s2=log.acc_m_s2,
        mag=log.mag_gauss,
        has_mag=log.has_mag,
        magnetic_ned=np.tile(settings.reference.magnetic_ned, (n, 1)),
        truth=log.truth,
        start=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        weight=np.zeros(n),
    )
    own = _start_attitudes(settings, data, chosen) if log.reference == "none" else None
    for segment in chosen:
        data.weight[segment.first : segment.last + 1] = weights(log, segment) / total
        what[segment.first] |= log_kernel.START
        right = own[segment.first] if own is not None else log.truth[segment.first].tolist()
        data.start[segment.first] = _wrong_start(tuple(right))
        _mark_predictions(log, segment, what)
    return data


def _wrong_start(q_ned_frd: Quaternion) -> Quaternion:
    return multiply(exp(scale(WRONG_START_RAD, WRONG_START_AXIS)), q_ned_frd)


def _mark_predictions(log: LogData, segment: Segment, what: NDArray[np.int64]) -> None:
    """Mark where a prediction begins anew: after ``PREDICTION_S``, and after one step at least."""
    begun_s = log.time_s[segment.first]
    for i in range(segment.first + 1, segment.last + 1):
        if log.time_s[i] - begun_s >= PREDICTION_S - 1e-9:
            what[i] |= log_kernel.RESYNC
            begun_s = log.time_s[i]


def _start_attitudes(
    settings: Settings, data: Recorded, chosen: list[Segment]
) -> dict[int, Quaternion]:
    """By first sample, the attitude that its conditioned vectors show: the log has no reference."""
    prepared = _prepare(settings, data)
    equal = settings.reference._replace(s_magnetic=1.0, s_gravity=1.0, s_cross=1.0)
    found = {}
    for first, _ in chosen:
        vectors = weighted_vectors(
            equal,
            magnetic_frd=tuple(prepared.magnetic_b[first].tolist()),
            magnetic_share=float(prepared.weight[first] * prepared.magnetic_share[first]),
            gravity_frd=tuple(prepared.gravity_b[first].tolist()),
            gravity_share=1.0,
            weight=1.0,
        )
        found[first] = align(vectors)
    return found
