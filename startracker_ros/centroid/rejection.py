"""Counts of the spots left out, by reason."""

import numpy as np


class Rejections:
    """Counts each rejected spot once, under the first reason that holds."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def add(self, reason: str, count: int) -> None:
        """Add to the count of a reason; a count of zero leaves no entry."""
        if count:
            self.counts[reason] = self.counts.get(reason, 0) + count

    def reject(self, **reasons: np.ndarray) -> np.ndarray:
        """Count the spots by reasons, each (K,) bool; return True (K,) for those without any."""
        bad = np.zeros(len(next(iter(reasons.values()))), bool)
        for reason, spots in reasons.items():
            self.add(reason, int(np.count_nonzero(spots & ~bad)))
            bad |= spots
        return ~bad
