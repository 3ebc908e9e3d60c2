"""Rerun's library, for all that draw: imported here only, and only where a viewer is asked for."""

import os
from importlib import import_module
from typing import Any

from estimator.errors import InputError
from fuzzbee.viewer.process import MISSING

# The library logs errors only, but not that the viewer is gone: we report that ourselves.
os.environ.setdefault("RUST_LOG", "error,re_grpc_client=off,re_sdk::recording_stream=off")
try:
    rr: Any = import_module("rerun")
    rrb: Any = import_module("rerun.blueprint")
    bindings: Any = import_module("rerun_bindings")
except ImportError:
    raise InputError(MISSING) from None
