"""What the environment of the command may change of what it runs, and what not."""

import os
import re
from pathlib import Path

# The libraries' own switches are for their developers: some print on standard output,
# end the process, leave out checksums or what is drawn.
SWITCHES = (
    *("NUMBA_", "LLVMLITE_", "NUMPY_", "NPY_", "RERUN", "FORCE_RERUN", "MPL", "MATPLOTLIBRC"),
    *("MAV_IGNORE_CRC", "SOURCE_DATE_EPOCH", "UHLC_MAX_DELTA_MS", "ZENOH_RUNTIME"),
)
# These are meant for us, with values as here; code for any CPU is what containers ask for.
MEANT = {
    "NUMBA_NUM_THREADS": "[1-9][0-9]{0,3}",
    "NUMBA_DISABLE_JIT": "[01]?",
    "NUMBA_CPU_NAME": "generic",
    "MPLCONFIGDIR": ".*",
    "MPLBACKEND": "(?i:agg)",
    "SOURCE_DATE_EPOCH": "[0-9]{1,10}",
}

# Linux's words for x86-64-v2, which numpy's wheels are made for: others end with SIGILL.
X86_64_V2 = ("cx16", "lahf_lm", "popcnt", "ssse3", "sse4_1", "sse4_2")
PROCESSORS = Path("/proc/cpuinfo")


def lacking_of_processor() -> list[str]:
    """What numpy takes for granted and a 64-bit x86 processor does not show that it has."""
    try:
        with PROCESSORS.open(encoding="ascii", errors="replace") as lines:
            reported = next((line.split() for line in lines if line.startswith("flags")), [])
    except OSError:  # another system
        return []
    return [word for word in X86_64_V2 if word not in reported] if "lm" in reported else []


def settle_environment() -> str | None:
    """Take away what is meant for other programs; returns a line that names it, if any."""
    os.environ["PYTHONSAFEPATH"] = "1"  # what Python starts for us imports nothing from this folder
    taken = [
        name
        for name, value in os.environ.items()
        if name.startswith(SWITCHES)
        and not (name in MEANT and re.fullmatch(MEANT[name], value, re.DOTALL))
    ]
    for name in taken:
        del os.environ[name]
    return f"{', '.join(sorted(taken))}: not used by fuzzbee" if taken else None
