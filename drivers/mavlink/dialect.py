"""pymavlink's message definitions."""

import os
from typing import Any


def mavlink() -> Any:
    """Import pymavlink's ardupilotmega dialect (it includes common), late: it takes 40 ms."""
    os.environ["MAVLINK20"] = "1"  # read by pymavlink when it is imported
    os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega
