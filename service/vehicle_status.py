"""The status record of one vehicle, made once a second, and its counts at the end of a run."""

from typing import Any, NamedTuple

from service.alarms import Alarm
from service.records import State, StatusRecord
from service.second_opinion import Verdict
from service.vehicle import Vehicle


class Load(NamedTuple):
    """The load of the service's loop.

    While it ``is_shedding``, only vehicles with a new sample have their attitude published. Right
    after a stop (``has_just_woken``) it is not known yet which silence is a vehicle's own.
    ``overruns`` are late ticks so far, ``dropped`` events and records thrown away, ``lost``
    datagrams that the system threw away; ``recording`` is the state of the recording.
    """

    is_shedding: bool = False
    has_just_woken: bool = False
    overruns: int = 0
    dropped: int = 0
    lost: int = 0
    recording: str = ""


def counts(vehicle: Vehicle) -> dict[str, Any]:
    """What was counted so far, as the result of a run has it."""
    return {
        "state": vehicle.state.value,
        "motion": vehicle.built_in_motion,
        "imu_message": vehicle.imu.message,
        "imu_rate_hz": round(vehicle.imu.median_rate_hz, 3),
        "worst_gap_s": vehicle.imu.worst_gap_us / 1e6,
        "samples": vehicle.imu.samples,
        "shed": vehicle.imu.shed,
        "attitudes": vehicle.publishing.attitudes,
        "rejected": dict(sorted(vehicle.rejected.items())),
    }


def status_record(vehicle: Vehicle, now_us: int, load: Load, malformed: int) -> StatusRecord:
    """The vehicle's status at ``now_us``; a silence that still lasts counts as a gap, too."""
    imu, publishing = vehicle.imu, vehicle.publishing
    words = set(vehicle.alarms.words)
    if vehicle.alarms.profile_is_unfit:
        words.add(Alarm.PROFILE_UNFIT)
    time_us = 0 if imu.last is None else publishing.clock.to_vehicle_us(now_us)
    autopilot = vehicle.comparison.record(time_us)
    if autopilot is not None and autopilot.verdict == Verdict.DIFFERS:
        words.add(Alarm.AUTOPILOT_DIFFERS)
    has_imu = vehicle.state in (State.ALIGNING, State.RUNNING)
    return StatusRecord(
        state=vehicle.state.value,
        imu_message=imu.message,
        imu_rate_hz=imu.median_rate_hz if has_imu else 0.0,
        worst_gap_s=max(imu.worst_gap_us, imu.silence_us(now_us)) / 1e6,
        rejected=dict(sorted(vehicle.rejected.items())),
        overruns=load.overruns,
        dropped=load.dropped,
        sequence=publishing.statuses,
        rates=vehicle.estimator.rates,
        gain=vehicle.estimator.gain_in_words,
        overloaded=load.is_shedding,
        shed=imu.shed,
        lost=load.lost,
        published_hz=publishing.published_hz(now_us, is_shedding=load.is_shedding),
        malformed=malformed,
        warnings=tuple(sorted(words)),
        retuned=publishing.retuned,
        autopilot=autopilot,
        recording=load.recording,
        mode=vehicle.parameters.mode,
        armed=vehicle.parameters.is_armed,
        other_imus=vehicle.others.records(now_us),
        compass_off_deg=vehicle.alarms.compass_off_deg,
    )
