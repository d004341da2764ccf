"""From what arrives on the line to the likely cause, in words for whoever stands beside the robot."""

HICCUP_S = 1.0  # silence or noise for so long is no hiccup but a cause to name


class LineWatch:
    """When bytes and good frames came last.

    Parameters
    ----------
    protocol : str
    baud : int
        Both only for the words.
    """

    def __init__(self, protocol: str, baud: int) -> None:
        self._protocol = protocol
        self._baud = baud
        self.reset(0.0)

    def reset(self, now_s: float) -> None:
        """The port was opened."""
        self._byte_s = self._frame_s = now_s
        self._bytes_framed = -1

    def received(self, now_s: float) -> None:
        """Bytes came."""
        self._byte_s = now_s

    def framed(self, now_s: float) -> None:
        """A good frame came."""
        self._frame_s = now_s

    def count(self, bytes_framed: int, now_s: float) -> None:
        """So many bytes were part of good frames until now, whatever frames they were."""
        if bytes_framed > self._bytes_framed >= 0:
            self._frame_s = now_s
        self._bytes_framed = bytes_framed

    def fault(self, now_s: float) -> str:
        """The likely cause of nothing coming through; empty when frames do."""
        if now_s - self._byte_s >= HICCUP_S:
            return "no bytes arrive: is the board powered, is this its port, are its two lines swapped?"
        if now_s - self._frame_s >= HICCUP_S:
            return (
                f"bytes arrive but no frame passes: wrong baud rate ({self._baud} configured), "
                f"wrong protocol ({self._protocol} configured), or noise"
            )
        return ""
