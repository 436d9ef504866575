"""The memory that a kernel keeps to itself."""

from collections.abc import Hashable


class Frame:
    """Places of some bytes each, by a key; freed ones are given away again."""

    def __init__(self) -> None:
        self.size = 0
        self._places: dict[Hashable, tuple[int, int]] = {}
        self._free: dict[int, list[int]] = {}

    def place(self, key: Hashable, size: int) -> int:
        """The offset of the place of `key`, which is made where there is none."""
        if key not in self._places:
            free = self._free.get(size)
            if free:
                offset = free.pop()
            else:
                offset = self.size
                self.size += size
            self._places[key] = offset, size
        return self._places[key][0]

    def free(self, key: Hashable) -> None:
        offset, size = self._places.pop(key)
        self._free.setdefault(size, []).append(offset)
