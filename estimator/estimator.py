"""One vehicle's estimator: samples in, attitude out. No I/O and no clock."""

from math import asin, isfinite, pi, radians, sqrt
from typing import NamedTuple

from estimator import kernel
from estimator.alignment import align
from estimator.filter_types import FilterState, initial_state
from estimator.observation import raw_vectors
from estimator.profile import Profile
from estimator.quaternion import exp, multiply, normalize, scale, subtract
from estimator.settings import settings_of
from estimator.types import ZERO_VEC3, Attitude, ImuSample, Vec3

# The output is propagated this far beyond the last sample at most, s; then the
# last rate says nothing about the vehicle any more.
OUTPUT_HORIZON_S = 1.0
# A rate beyond this is no vehicle's: 70 rad/s is 4000 deg/s, twice the range of common gyroscopes.
GYR_LIMIT_RAD_S = 70.0
# 40 g, well beyond the range of common accelerometers.
ACC_LIMIT_M_S2 = 400.0


class Snapshot(NamedTuple):
    """All that changes. Restoring it resumes with the same results."""

    filter: FilterState
    time_us: int
    rate_rad_s: Vec3
    aligned: bool


class Estimator:
    """The filter of a profile, fed sample by sample."""

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        self._fixed_gain = fixed_gain
        self.replace_profile(profile)
        self.restart()

    def replace_profile(self, profile: Profile) -> None:
        """Use other parameters from the next sample on; the estimate stays."""
        self.profile = profile
        self._settings = settings_of(profile, self._fixed_gain)

    def restart(self) -> None:
        """Forget the attitude and align anew, as after the vehicle's reboot."""
        self.snapshot = Snapshot(initial_state(), 0, ZERO_VEC3, False)

    @property
    def aligned(self) -> bool:
        """Whether there is an attitude yet."""
        return self.snapshot.aligned

    def update(self, sample: ImuSample) -> str | None:
        """Take one sample; None, or the reason why it was refused."""
        reason = refusal(sample)
        if reason is not None:
            return reason
        before = self.snapshot
        if before.aligned and sample.time_us <= before.time_us:
            return "not_later"
        chosen = self._settings
        if before.aligned:
            state = before.filter
            dt = 1e-6 * (sample.time_us - before.time_us)
        else:
            vectors = raw_vectors(
                chosen.reference, sample.acc_m_s2, sample.mag_gauss, sample.has_mag
            )
            state = initial_state(align(vectors) if chosen.initial is None else chosen.initial)
            dt = 0.0
        state = kernel.step(
            chosen.filter,
            chosen.reference,
            state,
            sample.gyr_rad_s,
            sample.acc_m_s2,
            sample.mag_gauss,
            sample.has_mag,
            dt,
        )
        rate = subtract(sample.gyr_rad_s, state.gyr_bias_rad_s)
        self.snapshot = Snapshot(state, sample.time_us, rate, True)
        return None

    def attitude(self, time_us: int) -> Attitude:
        """The attitude at ``time_us``, propagated from the last sample for output only."""
        now = self.snapshot
        ahead_s = min(max(1e-6 * (time_us - now.time_us), 0.0), OUTPUT_HORIZON_S)
        q = normalize(multiply(now.filter.q_ned_frd, exp(scale(ahead_s, now.rate_rad_s))))
        sigma = min(pi, max(radians(0.1), 2.0 * asin(sqrt(now.filter.error))))
        return Attitude(
            time_us=time_us,
            q_ned_frd=q,
            rate_rad_s=now.rate_rad_s,
            gyro_bias_rad_s=now.filter.gyr_bias_rad_s,
            error=now.filter.error,
            error_rate_1_s=now.filter.error_rate_1_s,
            gain=now.filter.gain,
            confidence_gravity=self._settings.reference.s_gravity,
            confidence_magnetic=self._settings.reference.s_magnetic,
            sigma_inclination_rad=sigma,
            sigma_heading_rad=sigma,
            heading_reference="true",
        )


def refusal(sample: ImuSample) -> str | None:
    """Why a sample cannot be used, in one word to count under; None if it can."""
    if not all(isfinite(x) for x in (*sample.gyr_rad_s, *sample.acc_m_s2, *sample.mag_gauss)):
        return "not_finite"
    if max(abs(x) for x in sample.gyr_rad_s) > GYR_LIMIT_RAD_S:
        return "gyroscope_out_of_range"
    if max(abs(x) for x in sample.acc_m_s2) > ACC_LIMIT_M_S2:
        return "accelerometer_out_of_range"
    return None
