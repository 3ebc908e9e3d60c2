"""The Rerun viewer as a sink: horizons, bodies in one place, curves.

What the eye needs is sent, and no more: a browser that draws in software takes in a few hundred
pieces a second, and what it cannot take in at once it shows late. So the horizon is one piece,
curves go in batches, and what stands still is sent once.
"""

from collections.abc import Sequence

from drivers.events import VehicleId
from estimator.profile import Profile
from fuzzbee.viewer import layout
from fuzzbee.viewer.page import Page
from fuzzbee.viewer.sdk import rr
from fuzzbee.viewer.stream import CLOSED, ViewerOptions, ViewerStream
from service.records import (
    AttitudeRecord,
    Departed,
    Message,
    Output,
    Peer,
    Published,
    Replaced,
    StatusRecord,
    vehicle_name,
)

PAGES_WAIT_US = 1_000_000  # a fleet appears within so long


class ViewerSink:
    """Draws what the service publishes with ``profile``.

    Raises:
        InputError: the extra is not installed, the viewer does not start, or the file
            cannot be written.
    """

    name = "viewer"

    def __init__(self, options: ViewerOptions, profile: Profile) -> None:
        self.stream = ViewerStream(options, layout.blueprint)
        self._pages: dict[VehicleId, Page] = {}
        self._has_left_out = False
        self._shared = profile  # for vehicles without parameters of their own
        self._own: dict[VehicleId, Profile] = {}
        self._now_us = 0
        self._pages_due_us: int | None = None  # vehicles wait for pages of their own
        self._arranged = 0  # so often
        self._is_live = options.live

    def handle(self, outputs: Sequence[Output]) -> None:
        """Draw the outputs that are due.

        Raises:
            ConnectionError: once, if the viewer has been closed.
            NotWholeError: once, if the file cannot be written any more.
        """
        self.stream.require_whole()
        if self.stream.take_loss():
            raise ConnectionError(CLOSED)
        if not self.stream.is_wanted:
            return
        for output in outputs:
            match output:
                case Published():
                    self._on_published(output)
                case Peer(vehicle=vehicle):
                    if vehicle in self._pages:
                        self._pages[vehicle].take_peer(output)
                case Replaced(vehicle=vehicle, profile=profile):
                    self._on_replaced(vehicle, profile)
                case Departed(vehicle=vehicle):
                    self._on_departed(vehicle)
                case Message(text=text):
                    self._say(text)

    def finish(self) -> None:
        """Send what is pending and leave the viewer open."""
        self._flush()
        self.stream.finish()

    def close(self) -> None:
        """Send what is pending, and end the viewer."""
        self._flush()
        self.stream.close()
        self.stream.require_whole()

    @property
    def is_whole(self) -> bool:
        """Whether the file that was asked for, if any, has everything so far."""
        return self.stream.is_whole

    def _on_published(self, output: Published) -> None:
        """Hand an attitude or a status to the vehicle's page."""
        record = output.record
        time_us = record.time_unix_us if isinstance(record, AttitudeRecord) else output.time_unix_us
        self._now_us = time_us or self._now_us
        page = self._page(output.vehicle) if self._now_us else None
        if page is None:
            return
        self._show_pages_if_due()
        if isinstance(record, StatusRecord):
            page.take_status(record, self._now_us)
        else:
            page.take_attitude(record, output.sample, len(self._pages))

    def _page(self, vehicle: VehicleId) -> Page | None:
        """The vehicle's page; a new one gets it as long as there is room."""
        if vehicle in self._pages:
            return self._pages[vehicle]
        if len(self._pages) >= layout.MOST_VEHICLES:
            if not self._has_left_out:
                self._say(f"only the first {layout.MOST_VEHICLES} vehicles are drawn")
            self._has_left_out = True
            return None
        profile = self._own.get(vehicle, self._shared)
        name = vehicle_name(vehicle)
        page = Page(name, self.stream, self._say, profile, is_live=self._is_live)
        self._pages[vehicle] = page
        if len(self._pages) == 1:
            self._show_pages()
        else:  # more may follow: a page for each takes a browser a while to take in
            self._have_pages_shown()
        return page

    def _have_pages_shown(self) -> None:
        """Arrange them soon; later each time: an arrangement takes 0.4 MB of a file."""
        if self._pages_due_us is None:
            self._pages_due_us = self._now_us + self._wait_us

    @property
    def _wait_us(self) -> int:
        return self._arranged * PAGES_WAIT_US

    def _show_pages(self) -> None:
        """Arrange a page for each vehicle."""
        self._pages_due_us = None
        self._arranged += 1
        self.stream.show(layout.blueprint([vehicle_name(v) for v in self._pages]))

    def _show_pages_if_due(self) -> None:
        due_us = self._pages_due_us
        if due_us is not None and not 0 < due_us - self._now_us <= self._wait_us:
            self._show_pages()

    def _on_departed(self, vehicle: VehicleId) -> None:
        """Give its page to the next one; what was drawn of it stays in the recording."""
        self._own.pop(vehicle, None)
        page = self._pages.pop(vehicle, None)
        if page is not None:
            page.curves.flush(self.stream)
            self._have_pages_shown()

    def _on_replaced(self, vehicle: VehicleId, profile: Profile) -> None:
        self._own[vehicle] = profile
        if vehicle in self._pages:
            self._pages[vehicle].profile = profile

    def _flush(self) -> None:
        """Send what waits: curves, and pages of the latest vehicles."""
        for page in self._pages.values():
            page.curves.flush(self.stream)
        if self._pages_due_us is not None:
            self._show_pages()

    def _say(self, text: str) -> None:
        if self._now_us:  # before the first record there is no time
            self._at_now()
            self.stream.log("/messages", rr.TextLog(text))

    def _at_now(self) -> None:
        self.stream.at(layout.TIMELINE, timestamp=1e-6 * self._now_us)
