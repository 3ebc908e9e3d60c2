"""The JSON of attitudes is that of their records, cut to decimals that nobody measures."""

import json
import random

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import VehicleId
from service import attitude_text
from service.attitude_rows import ROW_WHOLE, SHOWN_NUMBERS, AttitudeRows, attitude_of, expanded
from service.attitude_text import FORM, NUMBERS, WORDS, texts_of_records
from service.health import State
from service.records import AttitudeRecord, Confidence, Message, Published, Sigma
from tests.drivers.mavlink.test_usual_frames import is_compiled
from tests.service.records import record

# Of each number in the order of the record's fields, half of its last decimal; and some more for
# what doubles cannot say.
DECIMALS = [9] * 4 + [6] * 3 + [9] * 3 + [9] * 3 + [9, 9, 6] + [6, 6] + [6, 6]

in_range = st.floats(-1e6, 1e6)
records = st.builds(
    AttitudeRecord,
    schema=st.just(1),
    time_unix_us=st.integers(0, 2**53),
    time_boot_us=st.integers(-(2**40), 2**53),
    q_ned_frd=st.tuples(*[st.floats(-1.0, 1.0)] * 4),
    euler_deg=st.tuples(*[st.floats(-180.0, 360.0)] * 3),
    rate_rad_s=st.tuples(*[in_range] * 3),
    gyro_bias_rad_s=st.tuples(*[in_range] * 3),
    error=st.floats(0.0, 1.0),
    error_rate=in_range,
    gain=st.floats(0.0, 101.0),
    confidence=st.builds(Confidence, st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
    sigma_deg=st.builds(Sigma, st.floats(0.0, 180.0), st.floats(0.0, 180.0)),
    heading_reference=st.sampled_from(["true", "magnetic", "none"]),
    state=st.sampled_from([state.value for state in State]),
    age_ms=st.integers(0, 10**9).map(lambda us: us / 1e3),
    sequence=st.integers(0, 2**53),
)


def numbers_in(value):
    """All floating-point numbers of a record as JSON, in order."""
    if isinstance(value, dict):
        return [n for each in value.values() for n in numbers_in(each)]
    if isinstance(value, list):
        return [n for each in value for n in numbers_in(each)]
    return [value] if isinstance(value, float) else []


@given(records)
def test_the_text_is_the_record_in_fixed_decimals(made):
    (text,) = texts_of_records([made])
    read, whole = json.loads(text), json.loads(msgspec.json.encode(made))
    assert list(read) == list(whole)
    *figures, age_ms = numbers_in(read)
    *expected, expected_age_ms = numbers_in(whole)
    assert age_ms == expected_age_ms
    for figure, before, decimals in zip(figures, expected, DECIMALS, strict=True):
        assert abs(figure - before) <= 0.5 * 10**-decimals + 1e-15 * abs(before)
    others = ("time_unix_us", "time_boot_us", "sequence", "heading_reference", "state")
    assert [read[name] for name in others] == [whole[name] for name in others]
    assert msgspec.json.decode(text, type=AttitudeRecord).sequence == made.sequence


@is_compiled
@given(st.lists(records, min_size=1, max_size=3))
def test_while_nothing_is_compiled_the_text_is_the_same(several):
    compiled = texts_of_records(several)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(attitude_text, "is_interpreting", lambda: True)
        assert texts_of_records(several) == compiled


def test_a_published_text_as_it_stands():
    made = record(12.3, -4.5, 359.9, sequence=7)
    (text,) = texts_of_records([made])
    assert text == (
        b'{"schema":1,"time_unix_us":1700000000123456,"time_boot_us":1000000,'
        b'"q_ned_frd":[-0.993481598,-0.107015055,0.039127272,-0.003338998],'
        b'"euler_deg":[12.3,-4.5,359.9],"rate_rad_s":[0.1,0.2,0.3],'
        b'"gyro_bias_rad_s":[0.01,0.02,0.03],"error":0.01,"error_rate":0.1,"gain":3.0,'
        b'"confidence":{"gravity":1.0,"magnetic":0.5},'
        b'"sigma_deg":{"inclination":1.0,"heading":5.0},'
        b'"heading_reference":"true","state":"running","age_ms":5.0,"sequence":7}'
    )
    assert texts_of_records([]) == []


@is_compiled
def test_rows_are_records_for_whoever_wants_those():
    rng, n = random.Random(1), 3
    whole = np.zeros((n, ROW_WHOLE), np.int64)
    whole[:] = [1_700_000_000_000_000, 5_000_000, 7_000, 3, 1, WORDS.index("running"), 4_900_000, 1]
    numbers = np.array([[rng.uniform(-1.0, 1.0) for _ in range(NUMBERS)] for _ in range(n)])
    readings = np.arange(float(n * (SHOWN_NUMBERS - NUMBERS))).reshape(n, -1)
    vehicles = [VehicleId(k + 1, 1) for k in range(n)]
    rows = AttitudeRows(vehicles, whole, np.hstack((numbers, readings)))
    published = expanded([Message("before"), rows])[1:]
    assert [each.vehicle for each in published] == vehicles
    for k, each in enumerate(published):
        made = attitude_of(each)
        assert isinstance(each, Published)
        assert made is not None
        assert made.q_ned_frd == tuple(numbers[k, :4])
        assert (made.heading_reference, made.state, made.age_ms) == ("magnetic", "running", 7.0)
        assert each.sample.time_us == 4_900_000
        assert each.sample.gyr_rad_s == tuple(readings[k, :3])
        assert each.sample.mag_gauss == tuple(readings[k, 6:])
    assert rows.texts == texts_of_records([attitude_of(each) for each in published])
    assert FORM.count("%") == NUMBERS + 6
