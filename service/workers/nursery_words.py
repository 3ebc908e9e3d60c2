"""What the service and its nursery say to each other."""

from struct import Struct
from typing import NamedTuple

from estimator.profile import Profile

REQUEST = Struct("<I")  # the number of a worker; its end of a connection comes along
NEWS = Struct("<cii")  # what, process, number of the worker or exit status
READY, BORN, DEAD = b"R", b"B", b"D"


class Setup(NamedTuple):
    """What to compile before the first worker."""

    profile: Profile
    gain: float | None
    with_raw: bool
