"""``python -m fuzzbee``."""

from fuzzbee import sigint_guard  # noqa: F401, I001 - before all others

import sys
from pathlib import Path

# Python puts the current folder first: beside downloaded logs, what lies there would be run.
if not sys.flags.safe_path and Path(sys.path[0]) != Path(__file__).resolve().parents[1]:
    del sys.path[0]

from fuzzbee.cli import entry_point

entry_point()
