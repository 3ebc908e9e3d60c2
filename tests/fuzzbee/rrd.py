"""What a file of Rerun's holds, by Rerun's own program."""

import re
import subprocess

from fuzzbee.viewer.process import program


def listing(path, *options):
    done = subprocess.run(
        [program(), "rrd", "print", *(options or ("-vv",)), str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def rows(path, entity):
    """How often something was drawn there."""
    found = re.findall(
        rf"with (\d+) rows \(.*?\) - {re.escape(entity)} - data", listing(path, "-v")
    )
    return sum(map(int, found))


def chunks(path):
    """How many pieces have points."""
    kinds = "scalars|quaternion|vectors"
    return len(re.findall(rf"rows \(.*?\) - /\S+ - data.*(?:{kinds})", listing(path, "-v")))


def numbers(path, entity):
    """What was drawn there, a list of numbers a row."""
    text = listing(path, "-vvv", "--entity", entity)
    found = re.findall(r"row_\w+ +┆ \d{4}-\S+ +┆ \[+([^\]]*)\]+", text)
    return [[float("nan" if x == "null" else x) for x in row.split(", ")] for row in found]
