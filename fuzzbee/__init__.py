"""Live attitude from a MAVLink stream: what programs use of it. The rest is the command.

The names are imported when they are first used: the command answers before numba has loaded.
"""

from importlib import import_module

from fuzzbee.version import __version__

TYPE_CHECKING = False  # as typing has it, whose import takes longer than all others here
if TYPE_CHECKING:
    from estimator.errors import InputError
    from estimator.profile import load_profile
    from fuzzbee.array_estimator import Estimator
    from fuzzbee.log_replay import replay
    from fuzzbee.paper_filter import PaperFilter

__all__ = ["Estimator", "InputError", "PaperFilter", "__version__", "load_profile", "replay"]

_HOMES = {
    "Estimator": "fuzzbee.array_estimator",
    "InputError": "estimator.errors",
    "PaperFilter": "fuzzbee.paper_filter",
    "load_profile": "estimator.profile",
    "replay": "fuzzbee.log_replay",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'fuzzbee' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
