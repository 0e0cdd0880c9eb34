"""Commands that cannot be used: checked, refused or clipped with a warning, seldom repeated."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.simulation.journal import Journal

Array = NDArray[np.float64]

#: The same warning comes once in this much simulated time. Source: our own choice. [s]
WARNING_PERIOD_S = 2.0

log = logging.getLogger("trocar")


class Refusals:
    """Checks an arm's commands and says what is wrong with them.

    Attributes:
        count: how many commands were refused or clipped
        last: the last reason
    """

    def __init__(self, arm: str, time: Callable[[], float], journal: Journal) -> None:
        self.count = 0
        self.last = ""
        self._arm = arm
        self._time = time
        self._journal = journal
        self._said: dict[str, float] = {}
        self._unsaid: dict[str, int] = {}

    def warn(self, kind: str, reason: str) -> None:
        """Count a refused or clipped command; say so once a while, with how many were not said."""
        self.count += 1
        self.last = reason
        now = self._time()
        if now - self._said.get(kind, -np.inf) < WARNING_PERIOD_S:
            self._unsaid[kind] = self._unsaid.get(kind, 0) + 1
            return
        self._said[kind] = now
        more = self._unsaid.pop(kind, 0)
        text = f"{reason} ({more} more such since)" if more else reason
        log.warning("%s: %s", self._arm, text)
        self._journal.event(self._arm, "warning", text=text)

    def forget(self) -> None:
        """Say everything anew: time starts again."""
        self._said.clear()
        self._unsaid.clear()

    def vector(
        self, values: ArrayLike, names: tuple[str, ...], verb: str, what: str
    ) -> Array | None:
        """Return one finite number per name, (n,) float64, or warn and return None."""
        wanted = f"{len(names)} numbers for {', '.join(names)}"
        try:
            array = np.asarray(values)
        except (TypeError, ValueError):  # rows of unequal length
            array = np.asarray(None)
        if array.shape != (len(names),):
            got = f"of shape {array.shape}" if array.dtype.kind in "iuf" else "that are no numbers"
            self.warn(f"{verb} {what} shape", f"{verb}: got {what} {got}; allowed: {wanted}")
            return None
        if array.dtype.kind not in "iuf":
            self.warn(
                f"{verb} {what} type",
                f"{verb}: got {what} {array.tolist()!r}; allowed: {wanted}",
            )
            return None
        if not np.isfinite(array).all():
            self.warn(
                f"{verb} {what} finite",
                f"{verb}: got {what} {array.tolist()}; allowed: finite numbers",
            )
            return None
        return array.astype(np.float64)
