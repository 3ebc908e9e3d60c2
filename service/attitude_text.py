"""The JSON of attitudes, written by compiled code for many at a time.

Numbers have a fixed number of decimals, far beyond what any sensor tells, without the zeros at
their end. A record alone has the same text.
"""

from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from estimator.compilation.compiled import compiled, inlined, is_compiled_code
from estimator.compilation.direct import direct, types_of
from estimator.compilation.interpreted import is_interpreting
from service.health import State
from service.records import SCHEMA, AttitudeRecord

# Columns of an attitude's whole numbers; the words are numbers in WORDS.
UNIX_US, BOOT_US, AGE_US, SEQUENCE, REFERENCE, STATE = 0, 1, 2, 3, 4, 5
WHOLE = 6
# Its other numbers are in the order of the record's fields, from the quaternion to the sigmas.
NUMBERS = 20
WORDS = ("true", "magnetic", "none", *(state.value for state in State))
NUMBER_OF_WORD = {word: number for number, word in enumerate(WORDS)}
LONGEST_WORD = 16
# What stands between the numbers: %d a whole number, %s a word, %N one with N decimals.
FORM = (
    f'{{"schema":{SCHEMA},"time_unix_us":%d,"time_boot_us":%d,'
    '"q_ned_frd":[%9,%9,%9,%9],"euler_deg":[%6,%6,%6],"rate_rad_s":[%9,%9,%9],'
    '"gyro_bias_rad_s":[%9,%9,%9],"error":%9,"error_rate":%9,"gain":%6,'
    '"confidence":{"gravity":%6,"magnetic":%6},"sigma_deg":{"inclination":%6,"heading":%6},'
    '"heading_reference":"%s","state":"%s","age_ms":%3,"sequence":%d}'
)
AGE_DECIMALS = 3  # a thousandth of a millisecond is a microsecond
POWERS = np.array([10**n for n in range(19)], np.int64)
LONGEST = 1024  # bytes of a text
TEN = np.uint64(10)
PLACE, DIGIT_0, MINUS, POINT, WORD, INTEGER = (ord(c) for c in "%0-.sd")
# In which order the whole numbers stand in the text.
ORDER = np.array([UNIX_US, BOOT_US, REFERENCE, STATE, AGE_US, SEQUENCE], np.int64)

Array = Any  # numba ships no types


@compiled
def write_texts(
    form: Array, words: Array, whole: Array, numbers: Array, out: Array, ends: Array
) -> None:
    """Write a text a row into ``out``, one behind the other; ``ends[k]`` is the k-th's end.

    ``form`` is :data:`FORM`, ``words`` has a row a word, filled up with zeros.
    """
    at = 0
    for k in range(len(whole)):
        number, other, n = 0, 0, 0
        while n < len(form):
            if form[n] != PLACE:
                out[at] = form[n]
                at, n = at + 1, n + 1
                continue
            kind, n = form[n + 1], n + 2
            if kind == INTEGER:
                at = write_whole(out, at, whole[k, ORDER[other]])
                other += 1
            elif kind == WORD:
                at = write_word(out, at, words[whole[k, ORDER[other]]])
                other += 1
            elif kind == DIGIT_0 + AGE_DECIMALS:
                at = write_decimal(out, at, whole[k, ORDER[other]], AGE_DECIMALS)
                other += 1
            else:
                at = write_number(out, at, numbers[k, number], kind)
                number += 1
        ends[k] = at


@inlined
def write_word(out: Array, at: int, word: Array) -> int:
    """Write a word; returns its end."""
    for letter in word:
        if letter == 0:
            break
        out[at] = letter
        at += 1
    return at


@inlined
def write_whole(out: Array, at: int, value: int) -> int:
    """Write a whole number; returns its end."""
    if value < 0:
        out[at] = MINUS
        at, value = at + 1, -value
    size = 1
    while size < len(POWERS) and POWERS[size] <= value:
        size += 1
    return write_digits(out, at, unsigned(value), size)


@inlined
def write_digits(out: Array, at: int, value: Any, digits: int) -> int:
    """Write so many digits of a number; returns their end."""
    for i in range(at + digits - 1, at - 1, -1):
        rest = value // TEN
        out[i] = DIGIT_0 + value - rest * TEN
        value = rest
    return at + digits


@inlined
def unsigned(value: int) -> Any:
    """As a number without sign, which is divided in half the time."""
    return np.uint64(value)


@inlined
def write_number(out: Array, at: int, value: float, decimals: Any) -> int:
    """Write a number with the decimals that a digit of the form says; returns its end."""
    n: Any = np.int64(decimals) - DIGIT_0
    scaled: Any = np.int64(np.rint(value * POWERS[n]))
    return write_decimal(out, at, scaled, n)


@inlined
def write_decimal(out: Array, at: int, scaled: int, decimals: int) -> int:
    """Write ``scaled / 10**decimals``, with one decimal at least; returns its end."""
    if scaled < 0:
        out[at] = MINUS
        at, scaled = at + 1, -scaled
    at = write_whole(out, at, scaled // POWERS[decimals])
    out[at] = POINT
    at = write_digits(out, at + 1, unsigned(scaled % POWERS[decimals]), decimals)
    while decimals > 1 and out[at - 1] == DIGIT_0:
        decimals, at = decimals - 1, at - 1
    return at


class Form(NamedTuple):
    """What the writer is given besides numbers."""

    form: Array
    words: Array


@cache
def _form() -> Form:
    words = b"".join(word.encode().ljust(LONGEST_WORD, b"\0") for word in WORDS)
    table = np.frombuffer(words, np.uint8).reshape(len(WORDS), LONGEST_WORD)
    return Form(np.frombuffer(FORM.encode(), np.uint8), table)


def texts_of(whole: Array, numbers: Array) -> list[bytes]:
    """The JSON of attitudes, whose numbers (N, WHOLE) and (N, NUMBERS) are in these columns."""
    n = len(whole)
    out, ends = np.empty(n * LONGEST, np.uint8), np.zeros(n + 1, np.int64)
    _writer()(*_form(), whole, numbers, out, ends[1:])
    text, bounds = out[: ends[-1]].tobytes(), ends.tolist()
    return [text[begin:end] for begin, end in pairwise(bounds)]


def texts_of_records(records: Sequence[AttitudeRecord]) -> list[bytes]:
    """The JSON of attitudes."""
    if not records:
        return []
    whole = [_whole_of(record) for record in records]
    numbers = [numbers_of(record) for record in records]
    if is_compiled_code() and not is_interpreting():
        return texts_of(np.array(whole, np.int64), np.array(numbers))
    return list(map(_text_in_python, whole, numbers))


def _whole_of(record: AttitudeRecord) -> tuple[int, ...]:
    return (
        record.time_unix_us,
        record.time_boot_us,
        round(1e3 * record.age_ms),
        record.sequence,
        NUMBER_OF_WORD[record.heading_reference],
        NUMBER_OF_WORD[record.state],
    )


def numbers_of(record: AttitudeRecord) -> tuple[float, ...]:
    """The numbers of an attitude in their columns."""
    return (
        *record.q_ned_frd,
        *record.euler_deg,
        *record.rate_rad_s,
        *record.gyro_bias_rad_s,
        record.error,
        record.error_rate,
        record.gain,
        record.confidence.gravity,
        record.confidence.magnetic,
        record.sigma_deg.inclination,
        record.sigma_deg.heading,
    )


def _text_in_python(whole: tuple[int, ...], numbers: tuple[float, ...]) -> bytes:
    """The same, while nothing is compiled."""
    first, *parts = FORM.split("%")
    integers, others = iter(ORDER.tolist()), iter(numbers)
    text = first
    for part in parts:
        kind, rest = part[0], part[1:]
        if kind == "d":
            said = str(whole[next(integers)])
        elif kind == "s":
            said = WORDS[whole[next(integers)]]
        elif int(kind) == AGE_DECIMALS:
            said = _decimal(whole[next(integers)], AGE_DECIMALS)
        else:
            said = _decimal(round(next(others) * 10 ** int(kind)), int(kind))
        text += said + rest
    return text.encode()


def _decimal(scaled: int, decimals: int) -> str:
    whole, rest = divmod(abs(scaled), 10**decimals)
    digits = f"{rest:0{decimals}d}".rstrip("0") or "0"
    return f"{'-' if scaled < 0 else ''}{whole}.{digits}"


@cache
def _writer() -> Callable[..., None]:
    return direct(write_texts, argument_types())


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`write_texts` is called with."""
    whole, numbers = np.zeros((0, WHOLE), np.int64), np.zeros((0, NUMBERS))
    out, ends = np.empty(0, np.uint8), np.zeros(1, np.int64)
    return types_of(*_form(), whole, numbers, out, ends)
