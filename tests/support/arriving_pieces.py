"""A serial line on which given pieces arrive."""

from tiltcal.errors import BusError


class ArrivingPieces:
    """A line on which these pieces arrive one by one (an empty one: it is unplugged); then there is silence."""

    letter = "r"

    def __init__(self, *pieces: bytes) -> None:
        self._pieces = list(pieces)
        self.heard: list[bytes] = []

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        if out:
            self.heard.append(out)
        if not count:
            return b""
        if not self._pieces:
            raise BusError("silent")
        if not self._pieces[0]:
            self._pieces.pop(0)
            raise BusError("unplugged")
        return self._pieces.pop(0)

    def close(self) -> None:
        assert not self._pieces, "pieces that the driver never took"
