"""What a file of Rerun's holds, by Rerun's own program."""

import re
import subprocess

from fuzzbee.viewer.process import _program


def listing(path, detail="-vv"):
    done = subprocess.run(
        [_program(), "rrd", "print", detail, str(path)], capture_output=True, text=True, check=True
    )
    return done.stdout


def rows(path, entity):
    """How often something was drawn there."""
    found = re.findall(
        rf"with (\d+) rows \(.*?\) - {re.escape(entity)} - data", listing(path, "-v")
    )
    return sum(map(int, found))
