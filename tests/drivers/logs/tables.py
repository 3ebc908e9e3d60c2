"""The same readings as tables of other people: WAYS has their text, encoding and description."""

import json
from math import pi

import numpy as np

NAMES = "time_s,gyr_x_rad_s,gyr_y_rad_s,gyr_z_rad_s,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2"
FIELD = ",mag_x_gauss,mag_y_gauss,mag_z_gauss"
ROWS = 40
FLU = np.array([1.0, -1.0, -1.0])


def readings():
    """Times in s (N,), rates in rad/s, forces in m/s^2, fields in gauss (N, 3), FRD."""
    rng = np.random.default_rng(31)
    level = np.array([0.0, 0.0, -9.81])
    return (
        np.arange(ROWS) * 0.01,
        rng.normal(0.0, 0.2, (ROWS, 3)),
        rng.normal(0.0, 0.3, (ROWS, 3)) + level,
        rng.normal(0.0, 0.01, (ROWS, 3)) + np.array([0.2, 0.05, 0.4]),
    )


def table(heading, columns, delimiter=",", comma=".", end="\n", form=".15g", quote=""):
    """The text of a table; what is NaN is left empty, a list has words."""

    def number(x):
        text = "" if x != x else f"{x:{form}}"
        return text.translate(str.maketrans(",.", ".,")) if comma == "," else text

    cells = []
    for column in columns:
        if isinstance(column, list):
            cells.append(column)
        else:
            cells += [map(number, each) for each in np.atleast_2d(column.T).tolist()]
    lines = (delimiter.join(quote + x + quote for x in row) for row in zip(*cells, strict=True))
    return end.join([*heading, *lines, ""])


def plain():
    return table([NAMES + FIELD], readings())


DEG, PER_G = 180.0 / pi, 1.0 / 9.80665
AXES = {"$": "xyz", "#": "XYZ", "~": "012"}
T, GYR, ACC, MAG = readings()
NUMBER, FREE, ZERO = np.arange(ROWS), 0.0 * ACC, 0.0 * T


def way(columns, above="", about=None, **written_as):
    """A table of columns by their titles; a title with a key of AXES has three."""
    titles = []
    for title in columns:
        sign = next((each for each in AXES if each in title), "")
        titles += [title.replace(sign, axis) for axis in AXES[sign]] if sign else [title]
    quote = written_as.get("quote", "")
    heading = [written_as.get("delimiter", ",").join(quote + each + quote for each in titles)]
    return lambda: above + table(heading, columns.values(), **written_as), "utf-8", about


def german():
    t, gyr, acc, mag = readings()
    columns = (1.6e12 + 1e3 * t, np.degrees(gyr * FLU), acc * FLU / 9.80665, 100 * mag * FLU)
    heading = [
        "Gerät: Nr. 7;Version 2,1",
        "Stempel;Dreh X;Dreh Y;Dreh Z;Kraft X;Kraft Y;Kraft Z;Feld X;Feld Y;Feld Z",
        "ms;°/s;°/s;°/s;g;g;g;µT;µT;µT",
    ]
    return table(heading, columns, ";", ",", "\r\n")


def toml(**entries):
    """The description of a table: quantities and what is given of each."""
    lines = (
        f"{name} = {{ {', '.join(f'{key} = {json.dumps(x)}' for key, x in each.items())} }}"
        for name, each in entries.items()
    )
    return "\n".join(lines)


def xyz(form, **more):
    return {"columns": [form.replace("$", axis) for axis in "XYZ"], **more}


GERMAN = 'axes = "flu"\n' + toml(
    time={"columns": ["stempel"]}, gyroscope=xyz("Dreh $"), accelerometer=xyz("Kraft $"),
    magnetometer={"columns": ["Feld X µT", "Feld Y", "Feld Z"]},
)  # fmt: skip


def nameless():
    return table([], (NUMBER, 1e6 * T, ACC, 1e3 * MAG, GYR), "\t")


NAMELESS = toml(
    time={"columns": [2], "unit": "us"},
    accelerometer={"columns": [3, 4, 5], "unit": "m/s^2"},
    magnetometer={"columns": [6, 7, 8], "unit": "mG"},
    gyroscope={"columns": [9, 10, 11], "unit": "rad/s"},
)


def late_field():
    """The first rows lack all but the time, then most of what a wide table has."""
    lines = plain().splitlines()
    wide = [line + ",,,,,,,,,,,," for line in lines[1:]]
    return "\n".join([lines[0] + ",a,b,c,d,e,f,g,h,i,j,k,l", "0" + "," * 21, *wide, ""])


def commented():
    """Units in a line of their own, between brackets, an empty line below them."""
    names = ["time"] + [f"{s}{a}" for s in "gam" for a in "xyz"]
    units = ["[s]"] + ["[rad/s]"] * 3 + ["[m/s2]"] * 3 + ["[gauss]"] * 3
    rows = table([], readings())
    return "\n".join(["# logger v3, serial 12, 4", "", ",".join(names), ",".join(units), "", rows])


COUNTS = toml(
    time={"columns": ["millis"], "unit": "ms"},
    accelerometer={"unit": "g", "scale": 1 / 16384},
    gyroscope={"unit": "deg/s", "scale": 1 / 131},
    magnetometer={"unit": "gauss"},
)


def of_a_statistician():
    """Each row has a name, for which the heading has none."""
    heading, *rows = plain().splitlines()
    names = " ".join(f'"{name}"' for name in heading.split(","))
    lines = [f'"{k}" {row}'.replace(",", " ") for k, row in enumerate(rows, 1)]
    return "\n".join([names, *lines])


def open_ended():
    """A delimiter behind each row, none behind the heading."""
    heading, *rows = plain().splitlines()
    return "\n".join([heading, *(row + "," for row in rows)])


def in_levels():
    """Sensors, axes and units each in a line."""
    sensors = ["", *(s for s in ("gyr", "acc", "mag") for _ in "xyz")]
    axes, units = ["time", *"xyz" * 3], ["s", *(u for u in ("rad/s", "m/s2", "G") for _ in "xyz")]
    return table([",".join(line) for line in (sensors, axes, units)], readings())


CLOCK = [f"12:00:0{t:.6f}" for t in T]
DATES = [f"2024-03-01T{time}Z" for time in CLOCK]
RFU = np.array([1.0, 1.0, -1.0])
PLAIN = {"gyr_$_rad_s": GYR, "acc_$_m_s2": ACC, "mag_$_gauss": MAG}
EUROC = {"w_RS_S_$ [rad s^-1]": GYR, "ACCEL_#_MPS2": ACC, "mag_$_gauss": MAG}
PHONE = {  # right, forward, up
    "t[ns]": 1e9 * T,
    "w$[rad/s]": (GYR * RFU)[:, [1, 0, 2]],
    "a$[m/s^2]": (ACC * RFU)[:, [1, 0, 2]],
    "m$[nT]": (1e5 * MAG * RFU)[:, [1, 0, 2]],
}
WAYS = {
    "of an experiment": way(  # exponents, a free force beside the one that is felt
        {"Time (s)": T, "Linear Acceleration $ (m/s^2)": FREE, "Acceleration $ (m/s^2)": ACC,
         "Gyroscope $ (rad/s)": GYR, "Magnetic field $ (µT)": 100 * MAG},
        form=".15E", quote='"',
    ),
    "of many sensors": way(  # a last column that is a date in no format
        {"ACCELEROMETER # (m/s²)": ACC, "GRAVITY # (m/s²)": FREE,
         "LINEAR ACCELERATION # (m/s²)": FREE, "GYROSCOPE # (rad/s)": GYR,
         "MAGNETIC FIELD # (μT)": 100 * MAG, "Time since start in ms ": 1e3 * T},
        delimiter=";", end=";2015-02-13 18-49-01_123\n",
    ),
    "of a black box": way(  # what was done to the readings stands between sensor and axis
        {"loopIteration": NUMBER, "time (us)": 1e6 * T, "gyroADC[~] (deg/s)": DEG * GYR,
         "accSmooth[~] (g)": PER_G * ACC, "magADC[~] (Ga)": MAG},
        delimiter=", ",
    ),
    "counts": way(  # numbers as a cheap sensor's registers have them
        {"millis": 1e3 * T, "a$": 16384 * PER_G * ACC, "g$": 131 * DEG * GYR, "m$": MAG},
        about=COUNTS,
    ),
    "of a statistician": (of_a_statistician, "utf-8", None),
    "open ended": (open_ended, "utf-8", None),
    "in levels": (in_levels, "utf-8", None),
    "calibrated above": way(  # numbers above the heading, as many as below it
        {"time_s": T, **PLAIN}, "0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9,1\n"
    ),
    "date and time": way(
        {"Date": ROWS * ["2024-03-01"], "Time": CLOCK, **PLAIN},
        about='time = { columns = ["Date", "Time"] }',
    ),
    "of a phone app": way(  # each sensor has its own time and words; the first time is taken
        {"accelerometerTimestamp_sinceReboot(s)": T, "accelerometerAcceleration#(G)": PER_G * ACC,
         "gyroTimestamp_sinceReboot(s)": 2.0 * T, "gyroRotation#(rad/s)": GYR,
         "magnetometer#(µT)": 100 * MAG},
    ),
    "of a tracker": way(  # h for the field, and some other h without a unit
        {"Time(s)": T, "w$(deg/s)": DEG * GYR, "a$(g)": PER_G * ACC, "h$(uT)": 100 * MAG,
         "hx": ZERO},
        "StartTime: 2024-01-01 12:00:00\n", delimiter="\t",
    ),
    "of the first of two": way(
        {"time_s": T, "IMU1.gyro.$ (rad/s)": GYR, "IMU1.accel.$ (m/s^2)": ACC,
         "IMU1.mag.$ (Ga)": MAG},
        delimiter="|",
    ),
    "of two": way(  # two IMUs in one row; the names that are given have the units
        {"time_s": T, "imu0_gyr_$_rad_s": GYR, "imu0_acc_$_m_s2": ACC, "imu1_gyr_$_rad_s": GYR + 1,
         "imu1_acc_$_m_s2": ACC + 1, "mag_$_gauss": MAG},
        about=toml(gyroscope=xyz("imu0_gyr_$_rad_s"), accelerometer=xyz("imu0_acc_$_m_s2")),
    ),
    "late field": (late_field, "utf-8", None),
    "minutes": way({"Elapsed time (min)": T / 60, **PLAIN}),
    "counted": way({"": NUMBER, "time_s": T, **PLAIN}),  # as pandas writes it
    "quoted": way({"time_s": T, **PLAIN}, comma=",", quote='"'),
    "commented": (commented, "utf-8", None),
    "returns": (lambda: plain().replace("\n", "\r"), "utf-8", None),
    "plain": (plain, "utf-8", None),
    "byte order mark": (plain, "utf-8-sig", None),
    "utf-16": (plain, "utf-16", None),
    "german": (german, "cp1252", GERMAN),
    "phone": way(PHONE, "# ", 'axes = "rfu"', delimiter="  "),
    "phone in full": way(PHONE, "# ", 'axes = ["y", "x", "-z"]', delimiter="  "),
    "dates": way({"Zeit": DATES, **EUROC}),
    "dates, called otherwise": way({"Zeitstempel": DATES, **EUROC}),
    "elapsed": way(
        {"time": 1.7e18 + 1e9 * T, "seconds_elapsed": T, "rotationRate_$_rad_s": GYR,
         "acc_$_m_s2": ACC, "mag_$_gauss": MAG},
    ),
    "spelled": way(  # the axis before the sensor, its number behind; a free force beside it
        {"Time in seconds": T, "$_gyro_dps": DEG * GYR, "FreeAcc_#": FREE,
         "Accel1 # in m per s^2": ACC, "mag_$_gauss": MAG},
    ),
    "grouped": way(  # thousands between points, beside a decimal comma
        {"time_ms": 1.6e6 + 1e3 * T, "gyr_$_rad_s": GYR, "acc_$_mg": 1e3 * PER_G * ACC,
         "mag_$_gauss": MAG},
        delimiter=";", comma=",", form=",.12f",
    ),
    "nameless": (nameless, "utf-8", NAMELESS),
    "spanish": way(
        {"time (s)": T, "Gyro $ (º/s)": DEG * GYR, "Acc $ (m/s²)": ACC, "Mag $ (gauss)": MAG},
        delimiter=";", comma=",",
    ),
    "in thousandths": way(
        {"Time (microseconds)": 1e6 * T, "g$ (mrad/s)": 1e3 * GYR,
         "a$ (milli-g)": 1e3 * PER_G * ACC, "m$ (milligauss)": 1e3 * MAG},
    ),
    "as quotients": way(
        {"t / s": T, "ω_$ / (rad/s)": GYR, "a_$ / (m/s²)": ACC, "B_$ / µT": 100 * MAG},
        delimiter=";", comma=",",
    ),
    "of circuits": way(
        {"Time [us]": 1e6 * T, "LSM6DSO Gyro $ [mdps]": 1e3 * DEG * GYR,
         "LSM6DSO Acc $ [mg]": 1e3 * PER_G * ACC, "LIS2MDL Mag $ [mGauss]": 1e3 * MAG},
    ),
    "made of them": way(
        {"timestamp_us": 1e6 * T, "gyroscope_$_filtered_mdeg_s": 1e3 * DEG * GYR,
         "accelerometer_$_filtered_mm_s2": 1e3 * ACC, "magneto_$_filtered_uTesla": 100 * MAG},
    ),
    "in half words": way(
        {"% time(s)": T, "ang_vel_$ (rad/sec)": GYR, "accelerometer_$ (m/s/s)": ACC,
         "magnetic_$ (Gauss)": MAG},
    ),
}  # fmt: skip
