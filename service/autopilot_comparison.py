"""The autopilot's attitude of one vehicle beside ours: compared, judged, and reported."""

from drivers.events import FilterStatus, ReferenceAttitude
from estimator.geometry.earth import PlaceField
from estimator.types import Attitude, ImuSample, Quaternion, VelocitySample
from service.records import Autopilot, Peer, euler_deg
from service.second_opinion import Doubts, SecondOpinion, Verdict, in_words, turned_back

# What its filter reports of itself, once a second or so, holds until it reports something else.
FILTER_STATUS_HOLDS_US = 5_000_000


class AutopilotComparison:
    """Compares two attitudes of the same instant, and says when they begin or cease to differ."""

    def __init__(self) -> None:
        self.opinion = SecondOpinion()
        self.peers: dict[str, Peer] = {}  # others' latest attitudes, until ours is published
        self._filter_status: FilterStatus | None = None
        self._differed = False  # at the last look

    def take_velocity(self, sample: VelocitySample) -> None:
        """Note a velocity, which bears witness for either attitude."""
        self.opinion.hear_velocity(sample.time_us, sample.velocity_ned_m_s)

    def take_filter_status(self, event: FilterStatus) -> None:
        """Note what the autopilot's filter reports of itself."""
        self._filter_status = event

    def look(
        self,
        event: ReferenceAttitude,
        theirs: Quaternion,
        ours: Attitude,
        sample: ImuSample,
        place: PlaceField | None,
        against_ours: str,
    ) -> list[str]:
        """Compare ``theirs`` of the IMU with ours, which is of ``event`` or a little later.

        Returns a line when the two begin to differ, and one when that ends.
        """
        behind_us = max(sample.time_us - event.time_us, 0)
        doubts = Doubts(self._against_autopilot(event.arrival_us), against_ours)
        ours = turned_back(ours, 1e-6 * behind_us)
        self.opinion.look(event.time_us, event.message, theirs, ours, sample, place, doubts)
        opinion = self.opinion.opinion
        differs = opinion is not None and opinion.verdict is Verdict.DIFFERS
        before, self._differed = self._differed, differs
        if opinion is None or differs == before:
            return []
        if differs:
            return [in_words(opinion, event.time_us)]
        return ["the autopilot's attitude and ours agree"]

    def restart(self) -> None:
        """Begin anew, as our attitude does."""
        self.opinion.restart()

    def record(self, time_us: int) -> Autopilot | None:
        """The verdict at a time of the vehicle's clock; None if it sends no attitude."""
        self.opinion.forget(time_us)
        opinion = self.opinion.opinion
        if opinion is None:
            return None
        angles = zip(euler_deg(opinion.theirs), euler_deg(opinion.ours), strict=True)
        turned = [round((a - b + 180.0) % 360.0 - 180.0, 2) for a, b in angles]
        return Autopilot(
            verdict=opinion.verdict.value,
            message=opinion.message,
            for_s=max(0.0, round(1e-6 * (time_us - opinion.since_us), 1)),
            inclination_deg=round(opinion.inclination.off_deg, 2),
            heading_deg=round(opinion.heading.off_deg, 2),
            inclination_sigmas=round(opinion.inclination.sigmas, 1),
            heading_sigmas=round(opinion.heading.sigmas, 1),
            wrong=opinion.wrong,
            evidence=opinion.evidence,
            axis=opinion.axis,
            roll_deg=turned[0],
            pitch_deg=turned[1],
        )

    def _against_autopilot(self, now_us: int) -> str:
        """What the autopilot's filter reports against itself."""
        known = self._filter_status
        if known is None or abs(now_us - known.arrival_us) > FILTER_STATUS_HOLDS_US:
            return ""
        if not known.has_attitude:
            return "its own filter calls it not good"
        if max(known.velocity_ratio, known.compass_ratio) > 1.0:
            return "its own filter refuses velocity or compass"
        return ""
