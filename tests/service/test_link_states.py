"""Whatever happens on a link, what was sent is accounted for. LINK_STATES: how many sequences."""

import os
from collections import deque

from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from drivers.events import VehicleId
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.samples.imu_stream import MOST_HELD
from estimator.types import ZERO_VEC3
from service.vehicle_status import Load
from tests.service.flight_rig import START_US, Rig, S

LONGEST_FRAME = 280  # bytes
OTHER = VehicleId(7, 1)


class Link(RuleBasedStateMachine):
    """One vehicle's frames, with others, damage and clocks between them and the service."""

    def __init__(self):
        super().__init__()
        self.rig = Rig("imu")
        self.other = FrameEncoder(OTHER)
        self.sent = 0  # whole frames of the vehicle, of the present decoder and pipeline
        self.again = 0  # of them those that came before
        self.old: list[bytes] = []
        self.half = b""
        # the vehicle's times of the last samples; of these the service may have refused some
        self.sent_us: deque[int] = deque(maxlen=3)
        self.was_set_back = False  # by about a second or less: those may be late copies

    def pass_on(self, frame):
        self.rig.receive(self.half + frame)
        self.half = b""

    def fly_one(self, is_sent=True):
        sample = next(self.rig.samples)
        time_us = sample.time_us + self.rig.boot_shift_us
        if is_sent:
            self.was_set_back |= any(0 <= sent_us - time_us < 2 * S for sent_us in self.sent_us)
            self.sent_us.append(time_us)
        self.rig.now_us = max(self.rig.now_us, START_US + sample.time_us) + 1
        return self.rig.frame(sample)

    @rule(samples=st.integers(1, 40))
    def samples_come(self, samples):
        for _ in range(samples):
            frame = self.fly_one()
            self.pass_on(frame)
            self.sent += 1
            self.old = [*self.old[-20:], frame]

    @rule(samples=st.integers(1, 200))
    def samples_are_lost(self, samples):
        for _ in range(samples):
            self.fly_one(is_sent=False)

    @rule(data=st.binary(min_size=1, max_size=600))
    def garbage_comes(self, data):
        """Bytes of another sender behind half a frame of the vehicle may swallow a frame."""
        self.rig.receive(data, peer="noise")

    @rule(share=st.floats(0.1, 0.9))
    def half_a_frame_comes(self, share):
        """The other half comes with the next one."""
        frame = self.fly_one()
        split = max(1, int(share * len(frame)))
        self.pass_on(frame[:split])
        self.half, self.sent = frame[split:], self.sent + 1

    @rule(which=st.integers(0, 20))
    def a_frame_comes_again(self, which):
        if self.old and not self.half:
            self.pass_on(self.old[which % len(self.old)])
            self.again += 1

    @rule(seconds=st.floats(0.1, 20.0))
    def nothing_comes(self, seconds):
        self.rig.now_us += round(seconds * S)

    @rule(seconds=st.floats(-100.0, 100.0))
    def the_hosts_clock_is_set(self, seconds):
        self.rig.host_shift_us += round(seconds * S)

    @rule()
    def the_vehicle_boots_again(self):
        self.rig.boot_shift_us = -next(self.rig.samples).time_us

    @rule()
    def the_link_comes_again(self):
        """The half frame is gone with the link."""
        self.rig.readers["a"] = FrameReader()
        self.sent -= bool(self.half)
        self.half = b""

    @rule(frames=st.integers(1, 5))
    def another_vehicle_sends(self, frames):
        for _ in range(frames):
            message = raw_imu(self.rig.now_us, (0.0, 0.0, -9.8), ZERO_VEC3, ZERO_VEC3)
            self.rig.receive(self.other.frame(message, self.rig.now_us), peer="b")
            self.rig.now_us += S // 50

    @rule(woken=st.booleans(), shedding=st.booleans())
    def ticks_come_under_load(self, woken, shedding):
        self.tick(Load(has_just_woken=woken, is_shedding=shedding))

    def tick(self, load=Load()):  # noqa: B008 - immutable
        before = len(self.rig.records)
        self.rig.tick(load)
        assert len(self.rig.records) == before or self.sent > bool(self.half)

    @invariant()
    def ticks_go_on(self):
        self.tick()

    @invariant()
    def counts_add_up(self):
        vehicle = self.rig.vehicle
        if vehicle is None:
            return
        status = self.rig.status()
        handled = vehicle.imu.samples + status.shed + sum(status.rejected.values())
        whole = self.sent - bool(self.half)
        # a sample of another time, until the next one confirms or contradicts it; of a clock that
        # falls back by less than a second all, until it is known whether they are late copies
        held = MOST_HELD if self.was_set_back else 1
        assert whole - held <= handled <= whole + self.again

    @invariant()
    def what_is_published_is_numbered(self):
        sequences = [record.sequence for record in self.rig.records]
        assert sequences == list(range(len(sequences)))

    @invariant()
    def memory_is_bounded(self):
        assert all(len(reader._rest) <= LONGEST_FRAME for reader in self.rig.readers.values())
        assert len(self.rig.pipeline.vehicles) <= 2


Link.TestCase.settings = settings(
    max_examples=int(os.environ.get("LINK_STATES", "200")),
    stateful_step_count=30,
    phases=(Phase.generate,),  # what fails is read as it is: to make it shorter takes minutes
)
test_links = Link.TestCase
