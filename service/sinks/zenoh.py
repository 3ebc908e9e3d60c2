"""Attitudes, statuses and parameters on Zenoh.

Keys: ``{prefix}/{vehicle}/attitude``, ``.../status``, ``.../parameters``, and
the liveliness token ``.../alive``. A get on the first two is answered with the
last record; ``parameters`` answers with the profile, after replacing it if the
query has a payload.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import zenoh

from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.profile import Profile, profile_to_json
from service import records
from service.parameters import ParameterRequests
from service.records import AttitudeRecord, Output, Published, vehicle_name
from service.zenoh_session import Topic, close_session

JSON = "application/json"
LIVELINESS_S = 0.5  # to hear of other services; those known to the session answer at once
LONGEST_PAYLOAD = 65_536  # bytes; a whole profile has some 4,000


class ZenohSink:
    """Publishes on a session that it owns from then on.

    ``on_conflict`` is called with the key of a vehicle that another service publishes already.
    """

    name = "zenoh"

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        profile: Profile,
        requests: ParameterRequests,
        on_conflict: Callable[[str], None] | None = None,
    ) -> None:
        self._session = session
        self._prefix = prefix
        self._requests = requests
        self._on_conflict = on_conflict
        self._profile = profile
        self._profiles: dict[VehicleId, Profile] = {}
        self._topics: dict[tuple[VehicleId, type], Topic] = {}  # by the type of record
        self._tokens: dict[VehicleId, zenoh.LivelinessToken] = {}
        self._encode = msgspec.json.Encoder().encode
        # one for all keys: zenoh runs a thread for each
        self._queryable = session.declare_queryable(f"{prefix}/*/*", self._on_query)

    def handle(self, outputs: Sequence[Output]) -> None:
        """Publish the records among the outputs."""
        while outputs := self.handle_at_once(outputs):
            match outputs[0]:
                case Published(vehicle=vehicle, record=record):
                    self._topics[vehicle, type(record)] = self._new_topic(vehicle, type(record))
                case records.Evicted(vehicle=vehicle):
                    self._disappear(vehicle)
                    outputs = outputs[1:]

    def handle_at_once(self, outputs: Sequence[Output]) -> Sequence[Output]:
        """Publish what comes before the first output that changes keys, which others have to know.

        Returns the rest.
        """
        for k, output in enumerate(outputs):
            if isinstance(output, Published):
                record = output.record
                topic = self._topics.get((output.vehicle, type(record)))
                if topic is None:
                    return outputs[k:]
                topic.put(self._encode(record))
            elif isinstance(output, records.Replaced):
                self._profiles[output.vehicle] = output.profile
            elif isinstance(output, records.Evicted):
                return outputs[k:]
        return ()

    def close(self) -> None:
        """Close the session, which withdraws everything declared on it."""
        close_session(self._session)

    def _key(self, vehicle: VehicleId, kind: str) -> str:
        return f"{self._prefix}/{vehicle_name(vehicle)}/{kind}"

    def _new_topic(self, vehicle: VehicleId, record: type) -> Topic:
        if vehicle not in self._tokens:
            alive = self._key(vehicle, "alive")
            liveliness = self._session.liveliness()
            others = liveliness.get(alive, timeout=LIVELINESS_S) if self._on_conflict else ()
            if self._on_conflict and any(reply.ok is not None for reply in others):
                self._on_conflict(f"{self._prefix}/{vehicle_name(vehicle)}")
            self._tokens[vehicle] = liveliness.declare_token(alive)
        kind = "attitude" if record is AttitudeRecord else "status"
        return Topic(self._session, self._key(vehicle, kind), JSON)

    def _disappear(self, vehicle: VehicleId) -> None:
        """Withdraw everything of a vehicle."""
        for record in (AttitudeRecord, records.StatusRecord):
            if (topic := self._topics.pop((vehicle, record), None)) is not None:
                topic.withdraw()
        self._profiles.pop(vehicle, None)
        if (token := self._tokens.pop(vehicle, None)) is not None:
            token.undeclare()  # type: ignore[no-untyped-call]

    def _on_query(self, query: zenoh.Query) -> None:
        """Answer a get; on a thread of zenoh's, where an exception would vanish unseen."""
        with query:
            for topic in list(self._topics.values()):
                if topic.last and query.key_expr.intersects(zenoh.KeyExpr(topic.key)):
                    query.reply(topic.key, topic.last, encoding=JSON)
            for vehicle in list(self._tokens):
                key = self._key(vehicle, "parameters")
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    self._answer_parameters(query, key, vehicle)

    def _answer_parameters(self, query: zenoh.Query, key: str, vehicle: VehicleId) -> None:
        try:
            if query.payload is not None and len(query.payload) > 0:
                partial = _json_object(query.payload.to_bytes())
                self._profiles[vehicle] = self._requests.ask(vehicle, partial)
        except (InputError, TimeoutError) as error:
            query.reply_err(self._encode({"error": str(error)}), encoding=JSON)
            return
        profile = self._profiles.get(vehicle, self._profile)
        query.reply(key, self._encode(profile_to_json(profile)), encoding=JSON)


def _json_object(payload: bytes) -> dict[str, Any]:
    if len(payload) > LONGEST_PAYLOAD:
        raise InputError(f"the payload has {len(payload)} bytes, more than {LONGEST_PAYLOAD}")
    try:
        return msgspec.json.decode(payload, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"the payload is no JSON object: {error}") from None


class TogetherSink:
    """Publishes the newest attitude of each vehicle on ``{prefix}/attitudes``, once a period.

    The caller owns the session.
    """

    name = "together"

    def __init__(self, session: zenoh.Session, prefix: str, period_s: float) -> None:
        self._topic = Topic(session, f"{prefix}/attitudes", JSON)
        self._period_s = period_s
        self._due_s = 0.0
        self._newest: dict[str, AttitudeRecord] = {}

    def handle(self, outputs: Sequence[Output]) -> None:
        """Keep the attitudes among the outputs, and publish them when a period has passed."""
        for output in outputs:
            if isinstance(output, Published) and isinstance(output.record, AttitudeRecord):
                self._newest[vehicle_name(output.vehicle)] = output.record
        now_s = time.monotonic()
        if self._newest and now_s >= self._due_s:
            self._due_s = max(self._due_s + self._period_s, now_s)
            self._topic.put(msgspec.json.encode(self._newest))
            self._newest.clear()

    def close(self) -> None:
        """Withdraw the key; the session is closed by who has opened it."""
        self._topic.withdraw()
