"""For how many senders of one link there is room; more are noise or an attack."""

import os

LEAST_PLACES, MOST_PLACES = 512, 4096
# A vehicle with all that belongs to it takes a tenth of that.
MEMORY_OF_PLACE = 2 << 20


def places() -> int:
    """As many as there is memory for."""
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # another system than Linux or macOS
        memory = 0
    return max(LEAST_PLACES, min(MOST_PLACES, memory // MEMORY_OF_PLACE))


PLACES = places()
