"""Rerun's library, for all that draw: imported here only, and only where a viewer is asked for."""

import atexit
import os
from importlib import import_module
from typing import Any

from estimator.errors import InputError
from fuzzbee.viewer.process import MISSING

# The library logs errors, but not that the viewer is gone or a file not written: we report those.
OURS = ("re_grpc_client", "re_sdk::recording_stream", "re_log_encoding")
os.environ.setdefault("RUST_LOG", ",".join(["error", *(f"{name}=off" for name in OURS)]))
try:
    rr: Any = import_module("rerun")
    rrb: Any = import_module("rerun.blueprint")
except ImportError:
    raise InputError(MISSING) from None
# It waits at the process's end for what is pending, behind a full disk for ever; we close it.
atexit.unregister(rr.rerun_shutdown)
