"""Which columns of a table are what, in which unit and along which axes.

Names that have all of it (``gyro_x (deg/s)``, ``acc_y_m_s2``, ``time [ms]``) need no help. A small
TOML file beside the table gives what others lack::

    axes = "flu"                                # frd (the default), flu, rfu or as below
    time = { columns = ["stamp"], unit = "ms" }
    gyroscope = { columns = ["wx", "wy", "wz"], unit = "deg/s" }
    accelerometer = { unit = "g", axes = ["y", "x", "-z"] }     # forward is the sensor's y ...
    truth = { columns = ["qw", "qx", "qy", "qz"] }

Units are never guessed from the numbers.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from itertools import islice, takewhile
from math import pi
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec

from drivers.endpoint import columns_beside
from drivers.logs.csv_text import CsvText, is_date, is_number
from estimator.errors import InputError, file_text
from estimator.types import STANDARD_GRAVITY_M_S2 as G

LONGEST_LIST = 200  # characters of names in a message
HELP = "a TOML file of the same name beside it, or --columns FILE, can give it (docs/logs.md)"

Part = tuple[int, float]  # the column, and the factor to SI units and our axes


class Quantity(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One entry of the file."""

    columns: tuple[str | int, ...] = ()
    unit: str = ""
    scale: Annotated[float, msgspec.Meta(gt=0.0, lt=1e9)] = 1.0  # how much of it a count is
    axes: str | tuple[str, ...] = ""


class Description(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file."""

    axes: str | tuple[str, ...] = ""
    time: Quantity = Quantity()
    gyroscope: Quantity = Quantity()
    accelerometer: Quantity = Quantity()
    magnetometer: Quantity = Quantity()
    position: Quantity = Quantity()
    velocity: Quantity = Quantity()
    truth: Quantity = Quantity()
    autopilot: Quantity = Quantity()
    compass_calibrated: bool | None = None  # None: it is not known


class Columns(NamedTuple):
    """What is read of a row.

    The time is in us, or in words (ISO 8601, date and time may stand apart) where its factor is 0.
    ``parts`` has those of the other quantities that are there, by the names in :data:`KINDS`:
    rad/s, m/s^2, gauss (FRD), m/s (NED), degrees and m. Attitudes are four numbers, w first, or
    three angles (roll, pitch, yaw) in rad; those that are East-North-Up and FLU are named in
    ``enu_flu``. Axes that nobody gave may be others.
    """

    time: tuple[Part, ...]
    parts: dict[str, tuple[Part, ...]]
    enu_flu: frozenset[str]
    checks_axes: bool


TIME = {"min": 6e7, "s": 1e6, "ms": 1e3, "millis": 1e3, "us": 1.0, "micros": 1.0, "ns": 1e-3}
TIME |= {"minutes": 6e7, "nanos": 1e-3}
ANGLE = {"rad": 1.0, "deg": pi / 180}
GYROSCOPE = {"rads": 1.0, "degs": pi / 180, "dps": pi / 180, "mrads": 1e-3, "mdps": pi / 180e3}
GYROSCOPE |= {"mdegs": pi / 180e3, "rads1": 1.0, "degs1": pi / 180, "radps": 1.0, "degps": pi / 180}
ACCELEROMETER = {"ms2": 1.0, "mss": 1.0, "mps2": 1.0, "g": G, "mg": 1e-3 * G, "cms2": 1e-2}
ACCELEROMETER |= {"mms2": 1e-3, "millig": 1e-3 * G}
TESLA = {"t": 1e4, "tesla": 1e4, "mt": 1e1, "ut": 1e-2, "utesla": 1e-2, "nt": 1e-5}
TESLA |= {"microtesla": 1e-2}
GAUSS = {"g": 1.0, "ga": 1.0, "gs": 1.0, "gauss": 1.0, "mg": 1e-3, "mga": 1e-3, "mgauss": 1e-3}
MAGNETOMETER = TESLA | GAUSS | {"milligauss": 1e-3}
BODY_AXES = {"frd": ("x", "y", "z"), "flu": ("x", "-y", "-z"), "rfu": ("y", "x", "-z")}
WORLD_AXES = {"ned": ("x", "y", "z"), "enu": ("y", "x", "-z")}


class Kind(NamedTuple):
    """What a quantity may be.

    Units and what they are of ours (a quaternion's four columns have none, w is first); its axes by
    name, of which the first is meant where none is given; what its columns are called, with the
    unit as a group; how many there are.
    """

    units: Mapping[str, float]
    axes: Mapping[str, tuple[str, str, str]] | None = None
    titles: tuple[str, ...] = ()
    counts: tuple[int, ...] = (3,)


# What else may stand in a sensor's name, and before it: the circuit, a name with digits
MADE = "(?:rss|adc|smooth|raw|cal|filtered)?"
CIRCUIT = re.compile(r"^[A-Za-z]{2,}\d\w*[\W_]+")


def _sensor(words: str, units: Mapping[str, float]) -> Kind:
    spelt = "|".join(sorted(units, key=len, reverse=True))
    long = "|".join(word for word in words.split("|") if len(word) > 1)  # "x (g)" is no rate
    before, behind, unit = f"(?:{long})", rf"(?:{words})\d?{MADE}", f"(?:in)?({spelt})?"
    titles = (
        rf"(?:(?:imu|raw|sensor|cal)\d?)*(?:{axis}{before}{unit}|{behind}{unit}{axis}{MADE}{unit})"
        for axis in ("x(?:axis)?", "y(?:axis)?", "z(?:axis)?")
    )
    return Kind(units, BODY_AXES, tuple(titles))


RATE = (
    "gyro?s?|gyroscope|ang(?:ular)?vel(?:ocity)?|angularrate|(?:gyro)?rotation(?:rate)?|omega|w|g"
)
FORCE = "acc|accel|accelerometer|(?:accelerometer)?acceleration|a"
# B and H are other things without a unit
FIELD = "magn?|magneto(?:meter)?|magnetic(?:field)?|m|[bh](?=.*(?:t|tesla|gauss)$)"
# Names that leave nothing open, such as lat_deg and vel_n_m_s
PLACE = "lat(?:itude)?deg", "(?:lon|lng|longitude)deg", "alt(?:itude)?(?:msl)?m"
VELOCITY = tuple(f"v(?:el|elocity)?{axis}ms" for axis in ("n(?:orth)?", "e(?:ast)?", "d(?:own)?"))
ATTITUDE = Kind(ANGLE, counts=(3, 4))
KINDS = {
    "gyroscope": _sensor(RATE, GYROSCOPE),
    "accelerometer": _sensor(FORCE, ACCELEROMETER),
    "magnetometer": _sensor(FIELD, MAGNETOMETER),
    "position": Kind({"": 1.0, "deg": 1.0}, None, PLACE, (2, 3)),
    "velocity": Kind({"": 1.0, "ms": 1.0}, WORLD_AXES, VELOCITY),
    "truth": ATTITUDE,
    "autopilot": ATTITUDE,
}
QUATERNION = {"": 1.0, "wxyz": 1.0}
TIME_WORDS = "(?:accelerometer|imu|sensor)?(?:time|zeit|timestamp|t|elapsed|elapsedtime|sampletime)"
ISO = "iso8601"
SPELLINGS = (
    *(("[0]", "x"), ("[1]", "y"), ("[2]", "z"), ("ω", "w"), ("º", "deg")),
    *(("²", "2"), ("°", "deg"), ("µ", "u"), ("μ", "u"), ("per", ""), ("radians", "rad")),
    *(("radian", "rad"), ("degrees", "deg"), ("degree", "deg"), ("seconds", "s")),
    *(("second", "s"), ("sec", "s")),
)


def description(path: Path, given: Path | None) -> Description:
    """What is in the file ``given``, or else in the TOML file beside the table, if there is one.

    Raises:
        InputError: it cannot be read, or something in it cannot be.
    """
    beside = columns_beside(path)
    if given is None and not beside.is_file():
        return Description()
    file = given or beside
    try:
        return msgspec.convert(tomllib.loads(file_text(file, f"{file}")), Description)
    except FileNotFoundError:
        raise InputError(f"{file}: no such file") from None
    except msgspec.ValidationError as error:
        raise InputError(f"{file}: {str(error).replace('`', '').replace('$.', '')}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: no TOML file ({error or 'too deep'})") from None


def columns(text: CsvText, layout: Description) -> Columns:
    """Which columns to read.

    Raises:
        InputError: time, gyroscope or accelerometer is not there, or something is not clear.
    """
    time, parts, enu_flu = _time(text, layout.time), dict[str, tuple[Part, ...]](), set[str]()
    for name, kind in KINDS.items():
        entry: Quantity = getattr(layout, name)
        if found := _quantity(text, name, entry, layout.axes):
            parts[name] = found
        elif name in ("gyroscope", "accelerometer"):
            raise _unknown(text, f"{name}'s x")
        axes = entry.axes or layout.axes or "frd"
        if kind is ATTITUDE and found and axes not in ("frd", "flu"):
            raise InputError(f"axes {axes!r} of an attitude: must be frd (from NED) or flu (ENU)")
        if kind is ATTITUDE and axes == "flu":
            enu_flu.add(name)
    checks_axes = not (layout.axes or layout.accelerometer.axes)
    return Columns(time, parts, frozenset(enu_flu), checks_axes)


def _time(text: CsvText, entry: Quantity) -> tuple[Part, ...]:
    """Of several times that counts whose unit is known; one may be a date beside its time."""
    units, others = "|".join(TIME), list[int]()
    words = rf"({units})elapsed|(?:{TIME_WORDS})(?:since[a-z]+?)?(?:in)?({units}|{ISO})?"
    if entry.columns:
        index, *others = _named(text, "time", entry.columns, (1, 2))
        found = [(index, "")]
    else:
        found = _matches(text, words)
        found = found or [(i, ISO) for i, field in enumerate(text.first) if is_date(field)]
    if not found:
        raise _unknown(text, "time")
    index, unit = found[0]
    for i, titled in reversed(found):
        is_iso = ISO if is_date(text.first[i]) else ""
        if given := _compact(entry.unit) or is_iso or titled or _own_unit(text, i, TIME):
            index, unit = i, given
    first = " ".join(text.first[i].strip() for i in (index, *others))
    if others and is_date(first):
        unit = ISO
    if unit != ISO and first and not is_number(first, comma=text.has_decimal_comma):
        where = f"{first!r} in column {text.titles()[index]!r}"
        raise InputError(f"the time {where} is no number, and no date as ISO 8601 has them; {HELP}")
    factor = _factor(text, "time", index, unit, {**TIME, ISO: 0.0})
    return tuple((i, entry.scale * factor) for i in (index, *others))


def _quantity(
    text: CsvText, name: str, entry: Quantity, axes: str | tuple[str, ...]
) -> tuple[Part, ...]:
    """Its columns, along our axes; nothing if it is not there."""
    kind = KINDS[name]
    if entry.columns:
        found = [(i, "") for i in _named(text, name, entry.columns, kind.counts)]
    else:
        found = _by_title(text, name, kind)
    units, parts = kind.units if len(found) < 4 else QUATERNION, list[Part]()
    for i, unit in found:
        given = _compact(entry.unit) or unit or _own_unit(text, i, units)
        parts.append((i, entry.scale * _factor(text, name, i, given, units)))
    if not parts or kind.axes is None:
        return tuple(parts)
    along = entry.axes or (axes if kind.axes is BODY_AXES else "") or next(iter(kind.axes))
    chosen = kind.axes.get(along) if isinstance(along, str) else along
    if chosen is None or sorted(each.lstrip("-+") for each in chosen) != ["x", "y", "z"]:
        known = ", ".join(kind.axes)
        raise InputError(f'axes {along!r}: must be {known} or such as ["y", "x", "-z"]')
    # forward, right, down (or north, east, down) of x, y, z along those axes
    sources = [(parts["xyz".index(each[-1])], each.startswith("-")) for each in chosen]
    return tuple((i, -factor if minus else factor) for (i, factor), minus in sources)


def _by_title(text: CsvText, name: str, kind: Kind) -> list[tuple[int, str]]:
    """The columns that it is by their titles, with the units there; of a sensor x, y and z."""
    found = [_matches(text, each) for each in kind.titles]
    if kind.axes is BODY_AXES and any(found):
        for axis, those in zip("xyz", found, strict=True):
            if len(those) != 1:
                titles = ", ".join(repr(text.titles()[i]) for i, _ in those)
                what = f"may be {titles}" if those else "is missing"
                raise InputError(f"{name} {axis} {what}; {_there(text)}; {HELP}")
    clear = [those[0] for those in takewhile(lambda those: len(those) == 1, found)]
    return clear if len(clear) in kind.counts else []


def _named(
    text: CsvText, what: str, names: Sequence[str | int], counts: tuple[int, ...]
) -> list[int]:
    """The places of columns by their names, or by their numbers from 1 on."""
    if len(names) not in counts:
        wanted = " or ".join(map(str, counts))
        raise InputError(f"{what}: needs {wanted} columns, not {len(names)}")
    titles = [(title, *parts) for title, parts in zip(text.titles(), text.names, strict=True)]
    places: list[int] = []
    for name in names:
        if isinstance(name, int) and not 1 <= name <= len(titles):
            raise InputError(f"{what}: there is no column {name}, only 1 to {len(titles)}")
        wanted = str(name).strip().lower()
        found = [k for k, each in enumerate(titles) if wanted in [part.lower() for part in each]]
        if isinstance(name, str) and len(found) != 1:
            many = f"{len(found)} columns are" if found else "no column is"
            raise InputError(f"{what}: {many} called {name!r}; {_there(text)}")
        places.append(name - 1 if isinstance(name, int) else found[0])
    return places


def _matches(text: CsvText, pattern: str) -> list[tuple[int, str]]:
    """The columns whose title, or the upper part of it, is of that kind, and the units there."""
    found = []
    for i, parts in enumerate(text.names):
        spellings = ["".join(parts[:n]) for n in range(len(parts), 0, -1)]
        spellings += [CIRCUIT.sub("", each) for each in spellings]
        matches = filter(None, (re.fullmatch(pattern, _compact(each)) for each in spellings))
        found += [(i, next(filter(None, m.groups()), "")) for m in islice(matches, 1)]
    return found


def _own_unit(text: CsvText, index: int, units: Mapping[str, float]) -> str:
    """The unit at the end of a name that was given: in brackets, behind the axis, or below."""
    title = text.titles()[index]
    units_named = re.findall(r"[\[(]([^\])]*)[\])]\s*$", title) + list(text.names[index][1:])
    units_named += re.findall(r"[^a-z][xyz][^a-z]+([a-z].*)$", title.lower())
    return next((unit for each in units_named if (unit := _compact(each)) in units), "")


def _factor(text: CsvText, what: str, index: int, unit: str, units: Mapping[str, float]) -> float:
    if unit in units:
        return units[unit]
    known = ", ".join(filter(None, units))
    if unit:
        raise InputError(f"{what}: no unit of it is known as {unit!r} ({known})")
    raise InputError(f"the unit of {what}, column {text.titles()[index]!r}, is not given; {HELP}")


def _compact(name: str) -> str:
    """The name in small letters and digits alone, units in one spelling."""
    text = name.lower()
    for spelling, meant in SPELLINGS:
        text = text.replace(spelling, meant)
    return re.sub(r"[^a-z0-9]", "", text)


def _unknown(text: CsvText, what: str) -> InputError:
    return InputError(f"no column is known as the {what}; {_there(text)}; {HELP}")


def _there(text: CsvText) -> str:
    titles = ", ".join(text.titles())
    shown = titles if len(titles) <= LONGEST_LIST else f"{titles[:LONGEST_LIST]} ..."
    return f"there are: {shown}"
