# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows about the resources of processes over a long run."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from startracker_evaluation.harness.process_sample import ProcessSample
from startracker_ros.tools.figures.rows import Bounded

WARM_UP = 0.1
"""Share of a run that its figures leave out."""


@dataclass(frozen=True)
class ResourceRow(Bounded):
    """A figure of a run; error is 2 sigma."""

    error: float | None = None
    unit: str = ''
    bound: str = ''
    holds: bool = True


def growth(position: Sequence[float] | np.ndarray, values: Sequence[float] | np.ndarray
           ) -> tuple[float, float]:
    """
    Return the slope of values over position in the run and its error, 2 sigma.

    Neighbouring samples are not independent: the error is that of the means of ten blocks.
    """
    x, y = np.asarray(position, float), np.asarray(values, float)
    blocks = [block for block in np.array_split(np.arange(len(x)), 10) if len(block)]
    x, y = (np.array([part[block].mean() for block in blocks]) for part in (x, y))
    x = x - x.mean()
    slope = x @ (y - y.mean()) / (x @ x)
    residual = y - y.mean() - slope * x
    sigma = np.sqrt(residual @ residual / max(len(x) - 2, 1) / (x @ x))
    return float(slope), float(2 * sigma)


def tenths(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Return the medians of the first tenth and of the last."""
    tenth = max(len(values) // 10, 1)
    return float(np.median(values[:tenth])), float(np.median(values[-tenth:]))


def growth_rows(process: str, samples: Sequence[ProcessSample]) -> list[ResourceRow]:
    """Return the growth of handles and threads, which has to be 0."""
    rows = []
    for name in ('handles', 'threads'):
        first, last = tenths([getattr(sample, name) for sample in samples])
        rows.append(ResourceRow(f'{process}: {name}, growth', last - first, unit=name,
                                bound='= 0', holds=last <= first))
    return rows
