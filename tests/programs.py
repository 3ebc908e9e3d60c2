"""Python programs in processes of their own, which see the packages under test."""

import os
import subprocess
import sys
from pathlib import Path

import estimator

ROOT = str(Path(next(iter(estimator.__path__))).parent)


def run_python(*command, timeout_s, folder=None, check=True, inherited=os.environ, **environment):
    """``python *command``, with what its environment is to hold besides, and what came of it."""
    path = os.pathsep.join(filter(None, [ROOT, os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, *command],
        env={**inherited, "PYTHONPATH": path, **environment},
        cwd=folder,
        capture_output=True,
        text=True,
        check=check,
        timeout=timeout_s,
    )
