# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Spots left out, by reason."""

import numpy as np

_WORDS = {
    'edge': 'cut by the edge', 'saturated': 'saturated', 'hot_pixel': 'hot pixels',
    'cosmic_ray': 'hits of particles', 'elongated': 'longer than a star',
    'too_wide': 'wider than a star', 'not_fitted': 'of no shape of a star',
    'faint': 'too faint', 'disc': 'of something large', 'line': 'of a line'}
_REMEDIES = {
    'saturated': 'expose shorter', 'hot_pixel': 'subtract a dark frame',
    'cosmic_ray': 'subtract a dark frame', 'elongated': 'expose shorter, or let nothing shake',
    'too_wide': 'focus, and keep Moon and lamps out of the field',
    'disc': 'keep Moon, lamps and clouds out of the field',
    'line': 'expose shorter, or let nothing shake'}
_REMEDY = 'expose longer and focus'


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

    @property
    def text(self) -> str:
        """Return what the spots are, the most frequent first, and what helps against those."""
        counts = sorted(self.counts.items(), key=lambda item: -item[1])
        kinds = ', '.join(f'{count} {_WORDS.get(reason, reason)}' for reason, count in counts)
        return (f'none of {sum(self.counts.values())} detections is a star ({kinds}): '
                f'{_REMEDIES.get(counts[0][0], _REMEDY)}')

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
