import re
import signal

import numpy as np
import pytest

from fuzzbee.app import build_command
from fuzzbee.cli import main
from fuzzbee.version import __version__
from tests.fuzzbee.recording import DATA, FLIPS, PLANE, TAKEOFF
from tests.programs import run_python


def test_version_and_help(printed):
    assert printed("--version") == f"fuzzbee {__version__}\n"
    for arguments in (["--help"], []):
        out = printed(*arguments)
        for verb in ("run", "sim", "watch", "replay", "profile"):
            assert f"\n  {verb} " in out
        assert "╭" not in out  # boxes are for terminals
    summaries = out + printed("profile", "--help")
    assert "..." not in summaries.replace("[ARGS]...", "")  # they fit on their lines


TO, SENDING = ("--to", "udpout:127.0.0.1:14550"), ("--send-attitude", "udpout:127.0.0.1:9")
SIM, WRONG = ["replay", "sim:"], "--start-wrong"
NOWHERE = ("-l", "tcp/127.0.0.1:0", "-e", "tcp/127.0.0.1:9")
BAD = [
    (["nosuch"], "nosuch"),
    *((["run", "--rate", rate], f"--rate {rate}") for rate in ("0", "-5", "nan", "inf", "2000")),
    (["run", "--rate", "x"], "--rate x: should be a number\n"),
    *((["run", name, "0"], f"{name} 0") for name in ("--seconds", "--speed", "--request-rate")),
    (["run", "--speed", "2"], "--speed"),
    *(
        ([*verb, "--gain", k], f"--gain {k}")
        for k in ("0", "nan", "20000.5")
        for verb in (["run"], SIM)
    ),
    (["run", "--system-id", "256"], "256"),
    (["run", "--profile", "nosuch"], "nosuch"),
    (["run", "--no-zenoh", "/dev/ttyNOSUCH:57600"], "ttyNOSUCH"),
    (["run", "--no-zenoh", "udpin:127.0.0.1:0"], "port"),
    (["run", "--no-zenoh", "/dev/null:57600"], "/dev/null: not a serial device"),
    (["run", "--no-zenoh", "--record", "x.tlog"], "--record"),
    (["run", "--view", "hologram"], "--view hologram: should be window or web"),
    (["run", "-m", "router"], "router"),
    (["watch", "--prefix", "a/*"], "wildcards"),
    (["watch", "-e", "tcp//127.0.0.1:7447"], "--connect 'tcp//127.0.0.1:7447': should be like"),
    (["watch", "-e", "tcp/127.0.0.1"], "--connect 'tcp/127.0.0.1': should be like"),
    *((["run", "-l", at], f"--listen '{at}': should be like") for at in ("tls/[::1]", "7447")),
    (["watch", "-n", "0"], "--count 0"),
    (["watch", "-n", "x"], "--count x: should be a whole number\n"),
    (["run", "--profil", "imu"], "(Possible options: --profile)"),
    (["run", "--no-zenoh", "sim:", "--allow-system-ids", "1"], "ids is for a MAVLink link"),
    (["run", "--baud", "57600"], "No such option: --baud\n"),
    *(
        (["run", "udpout:127.0.0.1:9", f"--allow-system-ids={ids}"], "--allow-system-ids")
        for ids in ("", "0", "256", "3-1", "a", "1,,2", "-1", "1-")
    ),
    (["run", "--no-zenoh", "--ros"], "--no-zenoh"),
    (["run", *NOWHERE, "--ros", "--ros-domain", "233"], "233"),
    (["run", "--no-zenoh", "--send-attitude", "sim:"], "--send-attitude"),
    *((["run", "--no-zenoh", door, "0"], "65535") for door in ("--metrics", "--web")),
    *(
        (["run", "--no-zenoh", f"--web={text}"], f"--web {text}: should be PORT")
        for text in ("0", "65536", "http", "localhost:80", "1.2.3.4:", "-1", "")
    ),
    (["run", "--no-zenoh", "--as", "200:1"], "--send-attitude"),
    *((["run", "--no-zenoh", *SENDING, "--as", n], f"--as {n}: should") for n in ("200", "0:1")),
    (["run", "--no-zenoh", "--send-attitude", "udpout:127.0.0.1"], "port"),
    *(
        (["watch", name], "should be a vehicle")
        for name in ("copter", "1-", "*", "1/2", "1000", "0", "256", "1-300")
    ),
    (["sim"], "--to udpout:127.0.0.1:14550"),
    (["sim", "--to", "udpout:127.0.0.1"], "no port"),
    (["sim", "--to", "sim:"], "--to sim:"),
    (["sim", "--to", "/dev/ttyUSB0:57600"], "udpout, udpin, tcp, tcpin"),
    *((["sim", *TO, "--rate", rate], "rate") for rate in ("0", "nan")),
    (["sim", *TO, "--vehicles", "0"], "number of vehicles"),
    (["sim", *TO, "--vehicles", "1001"], "1000"),
    (["sim", *TO, "--seconds", "0"], "--seconds"),
    (["sim", *TO, "--motion", "loop"], "paper, rest, turn"),
    (["sim", *TO, "--noise", "-1"], "noise"),
    (["sim", *TO, "--magnet", "5"], "5:8"),
    (["sim", *TO, "--magnet", "8:5"], "later"),
    (["sim", *TO, "--drop", "2"], "drop"),
    (["sim", *TO, "--seed", "-1"], "seed"),
    (["replay", "udpin:127.0.0.1:14550"], "a live source is for fuzzbee run"),
    (["replay", "imu", "x.tlog"], "the profile is --profile imu"),
    (["replay", str(FLIPS), "--system-id", "9"], "(vehicles seen: 1)"),
    (["watch", "-m", "client", "-e", "tcp/127.0.0.1:9"], "tcp/127.0.0.1:9: nobody answers\n"),
    (["check", "missing.tlog"], "missing.tlog"),
    (["check", "."], "no log in this folder"),
    (["calibrate", str(TAKEOFF)], "too few turns"),
    (["calibrate", str(DATA / "rover_no_magnetometer.tlog")], "no magnetometer"),
    (["calibrate", str(PLANE), str(PLANE)], "20 samples a second"),
    *(
        (["calibrate", str(PLANE), "--place", place], "fuzzbee: --place")
        for place in ("here", "47.4", "90,0", "nan,8", "47,1000", "1,2,3")
    ),
    (["calibrate", "a.tlog", "b.tlog", "-o", "b.tlog"], "--output b.tlog: is also b.tlog"),
    (["calibrate", str(PLANE), "-o", "none/x.toml"], "no such folder"),
    # of replay, before anything is read
    (["replay", "sim:", "--seeds", "9-3"], "9-3"),
    (["replay", "sim:", "--seeds", "x"], "--seeds x"),
    (["replay", "sim:", "--profile", "imu"], "raw vectors"),
    (["replay", "sim:", "--profile", "folder.png"], "cannot be read: Is a directory"),
    (["profile", "check", "mine.toml"], "did you mean 'gamma'?"),
    *(
        ([*SIM, *option.split()], f"{option.split()[0]} is for logs")
        for option in ("--smooth", "--retune", "--from 3", "--mcap a.mcap", "--skip 1")
    ),
    ([*SIM, "a.tlog"], "sim:"),
    (["replay", "a.tlog", "--smooth", "--retune"], "--retune"),
    (["replay", "a.tlog", "--seeds", "1-2"], "--seeds"),
    *((["replay", "a.tlog", "--skip", skip], "--skip") for skip in ("-1", "nan")),
    *((["replay", "a.tlog", WRONG, n], f"{WRONG} {n}: must be") for n in ("900", "nan")),
    (["replay", "a.tlog", "--reference", "gps"], "gps"),
    (["replay", "a.tlog", "--profile", "nope"], "nope"),
    (["replay", "a.tlog", "b.tlog", "--csv", "a.csv"], "takes one log"),
    # a window of a log
    (["tune", "sim:", "-o", "x.toml", "--from", "3"], "--from"),
    (["tune", "sim:", "-o", "none/x.toml"], "no such folder"),
    *(
        (["replay", "a.tlog", *given], f"{' '.join(given)}: must be seconds (0 or more), arm or")
        for given in (("--from", "soon"), ("--to", "-1"), ("--from", "nan"))
    ),
    (["replay", "a.tlog", "--from", "9", "--to", "9"], "--to 9: must be later than --from 9"),
    (["replay", str(FLIPS), "--from", "1e4"], "no IMU data from 10000 s on: the log lasts"),
    (["replay", str(FLIPS), "--skip", "9999"], "after 9999 s of 20 s"),
    # what could not be written
    *((["replay", log, "--plot", "a.jpeg"], ".png, .svg, .pdf") for log in ("a.tlog", "sim:")),
    *(
        (["replay", "a.tlog", f"--{kind}", f"missing/a.{kind}"], "missing")
        for kind in ("csv", "tum", "parquet")
    ),
    (["replay", "sim:", "--csv", "missing/a.csv"], "missing"),
    (["replay", "a.tlog", "--plot", "missing/a.png"], "there is no such folder"),
    (["replay", "a.tlog", "--plot", "folder.png"], "is a folder"),
    # "" is what a variable of the shell is that nobody has set
    *((["tune", "sim:", "-o", name], "a folder, not a file") for name in ("", "/", "..")),
    *((["replay", str(FLIPS), "--tum", name], "is a folder") for name in ("", "/", "..")),
    (["replay", "a.tlog", "--csv", "/proc/a.csv"], "/proc/a.csv: No such file"),
]


@pytest.mark.parametrize(("arguments", "words"), BAD, ids=[" ".join(each) for each, _ in BAD])
def test_bad_input_is_one_line_and_status_2(arguments, words, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "mine.toml").write_text("[filter]\ngama = 1.0\n")
    assert words in refused(*arguments) + "\n"


@pytest.mark.parametrize(
    ("code", "slow"),
    [
        ("import fuzzbee.cli; fuzzbee.cli.main(['--help'])", "pymavlink matplotlib networkx"),
        ("import fuzzbee; assert 'Estimator' in dir(fuzzbee)", "numpy msgspec typer"),
    ],
)
def test_what_is_slow_is_imported_where_it_is_used(code, slow):
    slow = [*slow.split(), "numba", "scipy", "skfuzzy", "zenoh"]
    code = f"{code}; import sys; sys.exit(' '.join(m for m in {slow} if m in sys.modules) or 0)"
    run_python("-c", code, timeout_s=60)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_watch_is_ready_ends_it_well(monkeypatch, number):
    monkeypatch.setattr("fuzzbee.watch.follow", lambda *_, **__: signal.raise_signal(number))
    assert main(["watch"]) == 0


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGINT, 130)]
)
def test_an_interrupted_replay_leaves_its_status_and_no_file(monkeypatch, tmp_path, number, status):
    def columns(*_):
        yield {"time_s": np.zeros(1)}
        signal.raise_signal(number)

    monkeypatch.setattr("fuzzbee.replays.exports.columns", columns)
    assert main(["replay", str(TAKEOFF), "--csv", str(tmp_path / "a.csv")]) == status
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_that_a_library_makes_another_error_of_is_one(monkeypatch):
    """As where it falls into the import of an extension."""

    def fail(*_, **__):
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    monkeypatch.setattr("fuzzbee.replays.command._replay_logs", fail)
    assert main(["replay", str(DATA / "sub_bluerov.tlog")]) == 143


# Python would end by SIGINT, although the interrupt has been handled.
IN_A_TEXT = """
from fuzzbee import cli
cli._run_verb = lambda arguments: exec("raise KeyboardInterrupt")
cli.entry_point()
"""
LEFT_FOR_THE_END = """
import atexit
from fuzzbee import cli
atexit.register(print, "the end")
cli.entry_point()
"""
# The handler stands while the command's modules are imported; after that it is an exception again.
DURING_THE_IMPORTS = """
import os, signal
from fuzzbee import sigint_guard
os.kill(os.getpid(), signal.SIGINT)
print("went on")
"""
AFTER_THE_IMPORTS = """
import os, signal, fuzzbee.cli
try:
    os.kill(os.getpid(), signal.SIGINT)
except KeyboardInterrupt:
    print("yes")
"""


@pytest.mark.parametrize(
    ("program", "verb", "status", "out"),
    [
        (IN_A_TEXT, "run", 0, ""),
        (IN_A_TEXT, "tune", 130, ""),
        (LEFT_FOR_THE_END, "--version", 0, f"fuzzbee {__version__}\nthe end\n"),
        (DURING_THE_IMPORTS, "watch", 0, ""),
        (DURING_THE_IMPORTS, "replay", 130, ""),
        (AFTER_THE_IMPORTS, "run", 0, "yes\n"),
    ],
)
def test_an_interrupt_ends_with_our_status_and_no_traceback(program, verb, status, out):
    ended = run_python("-c", program, verb, timeout_s=900, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (status, out, "")


ON_A_PROCESSOR = """
import atexit, pathlib, sys; from fuzzbee import cli, environment
environment.PROCESSORS = pathlib.Path("cpuinfo")
atexit.register(lambda: print("numpy" in sys.modules)); cli.entry_point()
"""


@pytest.mark.parametrize(
    ("flags", "lacking"),
    [
        ("fpu lm sse2 pni cx16 lahf_lm ssse3 popcnt", "sse4_1, sse4_2"),
        ("fpu lm cx16 lahf_lm popcnt ssse3 sse4_1 sse4_2", None),
        ("fpu sse2", None),  # 32 bits have wheels of their own
        (None, None),  # another system
    ],
)
def test_without_x86_64_v2_the_command_ends_with_a_line_before_numpy(flags, lacking, tmp_path):
    if flags is not None:
        (tmp_path / "cpuinfo").write_text(f"processor\t: 0\nflags\t\t: {flags}\nbogomips\t: 1\n")
    ended = run_python("-c", ON_A_PROCESSOR, timeout_s=900, folder=tmp_path, check=False)
    assert ended.stdout.splitlines()[-1] == "False"
    line = f"fuzzbee: this processor has no {lacking}: numpy needs x86-64-v2\n"
    assert (ended.returncode, ended.stderr) == ((1, line) if lacking else (0, ""))


def test_help_on_a_terminal_keeps_its_defaults():
    """Rich takes brackets for styles."""
    tune = build_command(decorated=True).commands["tune"]
    assert r"\[default: 15" in next(p for p in tune.params if p.name == "cycles").help


@pytest.mark.parametrize(
    ("verb", "panels"),
    [
        ("run", ("Source", "Estimate", "Publish", "Record", "Show", "Zenoh")),
        ("replay", ("Source", "Estimate", "Score", "Record", "Show")),
        ("sim", ("Link", "Vehicle", "Show")),
        ("watch", ("Source", "Show", "Zenoh")),
    ],
)
def test_options_stand_in_the_panels_of_what_they_are_for(verb, panels, printed):
    """Nothing but the help itself is left over; below are examples."""
    text = printed(verb, "--help")
    assert f"fuzzbee {verb}" in text.partition("Examples:")[2]
    found = dict(re.findall(r"^(\w+):\n((?:  .*\n|\n)+)", text, re.MULTILINE))
    assert set(panels) == set(found) - {"Arguments", "Options", "Examples"}
    assert re.findall(r"--[\w-]+", found["Options"].split("Examples:")[0]) == ["--help"]
    if verb == "run":
        assert {"--ros-domain", "--as"} <= set(re.findall(r"--[\w-]+", found["Publish"]))
