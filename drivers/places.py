"""For how many senders of one link there is room; more are noise or an attack."""

from drivers.memory import total_bytes

LEAST_PLACES, MOST_PLACES = 512, 4096
# A vehicle with all that belongs to it takes a tenth of that.
MEMORY_OF_PLACE = 2 << 20


def places() -> int:
    """As many as there is memory for."""
    return int(max(LEAST_PLACES, min(MOST_PLACES, total_bytes() // MEMORY_OF_PLACE)))


PLACES = places()
