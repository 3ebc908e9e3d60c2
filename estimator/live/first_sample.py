"""The core after the first sample: aligned on it, or the given attitude corrected by it."""

from estimator.compilation.compiled import plain
from estimator.conditioning import condition
from estimator.filter import kernel
from estimator.filter.alignment import align
from estimator.filter.observation import raw_vectors
from estimator.filter.types import initial_state
from estimator.live.conditioned import conditioned_vectors
from estimator.live.core import UNSEEN, Core
from estimator.live.settings import Settings
from estimator.types import ImuSample, Sample


def first_core(settings: Settings, before: Core, sample: ImuSample) -> Core:
    """Nothing has turned yet. Plain Python: a single step is quicker so than taken into memory."""
    first = Sample(
        gyr_rad_s=sample.gyr_rad_s,
        acc_m_s2=sample.acc_m_s2,
        mag=sample.mag_gauss,
        has_mag=sample.has_mag,
        dt_s=0.0,
    )
    memory, seen = before.conditioning, UNSEEN
    if settings.conditioned:
        memory, seen = plain(condition)(settings.conditioning, memory, first)
        vectors = conditioned_vectors(settings.reference, seen)
    else:
        vectors = raw_vectors(settings.reference, first.acc_m_s2, first.mag, first.has_mag)
    q = align(vectors) if settings.initial is None else settings.initial
    first_step_s = settings.filter.first_step_s
    state = plain(kernel.correct)(settings.filter, initial_state(q), vectors, first_step_s)
    return before._replace(
        time_us=sample.time_us,
        sample=first,
        filter=state,
        smooth_error=state.error,
        conditioning=memory,
        seen=seen,
        reports=(),
    )
