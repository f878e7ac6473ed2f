# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Spots left out, by reason."""

import numpy as np


class Rejections:
    """Counts each rejected spot once, under the first reason that holds, with its position."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.uv: list[np.ndarray] = []

    def add(self, reason: str, uv: np.ndarray) -> None:
        """Add the spots at uv (K, 2) px for a reason; none leave no entry."""
        if len(uv):
            self.counts[reason] = self.counts.get(reason, 0) + len(uv)
            self.uv.append(np.asarray(uv, float))

    def include(self, other: 'Rejections') -> None:
        """Add all spots of another list."""
        for reason, count in other.counts.items():
            self.counts[reason] = self.counts.get(reason, 0) + count
        self.uv += other.uv

    def add_coded(self, reasons: tuple[str, ...], code: np.ndarray, uv: np.ndarray) -> None:
        """Add the spots at uv (K, 2) px with codes (K,) of reasons; 0 is none."""
        for one in sorted(set(code.tolist()) - {0}):
            self.add(reasons[one], uv[code == one])

    def reject(self, uv: np.ndarray, **reasons: np.ndarray) -> np.ndarray:
        """Add spots at uv (K, 2) by reasons, each (K,) bool; return True (K,) for the others."""
        bad = np.zeros(len(uv), bool)
        for reason, spots in reasons.items():
            if spots.any():
                self.add(reason, uv[spots & ~bad])
                bad |= spots
        return ~bad
