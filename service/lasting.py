"""What has been so for most of the time lately, rather than at this moment."""

BEGIN_SHARE, END_SHARE = 0.6, 0.3


class Lasting:
    """The share of time for which something is so; with a time constant of ``patience_s``.

    It is said from 0.6 on, so after 0.92 of that time if it is so all the time, until 0.3: a start
    or a magnet that passes says nothing.
    """

    def __init__(self, patience_s: float) -> None:
        self.share = 0.0  # below zero for what is so the other way round
        self.is_said = False
        self._patience_s = patience_s

    def look(self, is_so: int, dt_s: float) -> None:
        """Take what was so for ``dt_s``: 1, 0, or -1 for the other way round."""
        self.share += dt_s / (self._patience_s + dt_s) * (is_so - self.share)
        self.is_said = abs(self.share) > (END_SHARE if self.is_said else BEGIN_SHARE)
