# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rows of tables, a frozen type for each set of columns; the fields are the columns, in order."""

from collections.abc import Iterable
from dataclasses import dataclass, field, InitVar, KW_ONLY
import math

import numpy as np

Check = tuple[str, bool]
"""A bound in words, and whether it holds."""


def within(value: float, *, least: float | None = None, most: float | None = None,
           exactly: int | None = None) -> Check:
    """Return the bound of a value; without any it holds."""
    if exactly is not None:
        return f'= {exactly}', bool(value == exactly)
    if least is not None and most is not None:
        return f'{least:g} .. {most:g}', bool(least <= value <= most)
    if most is not None:
        return f'<= {most:g}', bool(value <= most)
    return ('', True) if least is None else (f'>= {least:g}', bool(value >= least))


def goal_text(goal: str, met: bool) -> str:
    """Return a bound that decides nothing, and whether it is met."""
    return f'{goal}, {"met" if met else "missed"}'


@dataclass(frozen=True)
class Bounded:
    """A figure of ours; its bound may be given as limits, which are not columns."""

    case: str
    ours: float
    _: KW_ONLY
    least: InitVar[float | None] = None
    most: InitVar[float | None] = None
    exactly: InitVar[int | None] = None

    def __post_init__(self, least: float | None, most: float | None, exactly: int | None
                      ) -> None:
        if {least, most, exactly} != {None}:
            bound, holds = within(self.ours, least=least, most=most, exactly=exactly)
            object.__setattr__(self, 'bound', bound)
            object.__setattr__(self, 'holds', holds)


@dataclass(frozen=True)
class Row(Bounded):
    """A figure of ours and its bound."""

    unit: str
    bound: str = ''
    holds: bool = True


@dataclass(frozen=True)
class DemoRow(Row):
    """A figure of a demo; goal is what a time of this machine should be, which decides nothing."""

    goal: str = ''

    @classmethod
    def with_goal(cls, case: str, ours: float, unit: str, goal: float, *, least: bool = False
                  ) -> 'DemoRow':
        """Return a row whose figure should be at most its goal, or at least."""
        check = within(ours, least=goal) if least else within(ours, most=goal)
        return cls(case, ours, unit, goal=goal_text(*check))

    @classmethod
    def of(cls, row: Row) -> 'DemoRow':
        """Return a row among those of a demo."""
        return cls(row.case, row.ours, row.unit, row.bound, row.holds)


@dataclass(frozen=True)
class BenchRow(Bounded):
    """A figure of ours next to that of a peer; ratio is ours over theirs."""

    unit: str
    peer: str = ''
    ratio: float | None = None
    bound: str = ''
    holds: bool = True


@dataclass(frozen=True)
class PercentileRow(Bounded):
    """A figure of ours, for times the median, with percentiles 95 and 99."""

    p95: float | None = None
    p99: float | None = None
    unit: str = 'ms'
    peer: str = ''
    ratio: float | None = None
    bound: str = ''
    holds: bool = True

    @classmethod
    def of_times(cls, case: str, times_ms: np.ndarray, p50_ms: float = np.inf,
                 p95_ms: float = np.inf) -> 'PercentileRow':
        """Return the percentiles of times (N,) in ms, with bounds of the median and of p95."""
        p50, p95, p99 = np.percentile(times_ms, [50, 95, 99])
        bound, holds = combined(
            ((f'{name} <= {limit:g}', value <= limit) for name, value, limit in (
                ('p50', p50, p50_ms), ('p95', p95, p95_ms)) if np.isfinite(limit)), ', ')
        return cls(case, p50, p95, p99, bound=bound, holds=holds)


@dataclass(frozen=True)
class CampaignRow(Bounded):
    """A figure of ours next to that of a paper."""

    paper: float | str | None
    unit: str
    bound: str = ''
    holds: bool = True


@dataclass(frozen=True)
class PaperRow:
    """
    A figure of a paper, next to it that of its method as published and that of ours beyond it.

    holds is None where there are too few trials for the bound. ours is the best we have: beyond
    or, where there is no such figure, as published.
    """

    case: str
    paper: float | str | None
    as_published: float | None = None
    beyond: float | None = None
    unit: str = ''
    bound: str = ''
    holds: bool | None = True
    ours: float | None = field(init=False)

    def __post_init__(self) -> None:
        best = self.as_published if self.beyond is None else self.beyond
        object.__setattr__(self, 'ours', best)


def judged(checks: Iterable[Check], trials: int, needed: int) -> tuple[str, bool | None]:
    """Return several checks as one; with fewer trials than needed it says so and is not judged."""
    text, holds = combined(checks)
    if trials < needed and text:
        return f'{text}: too few trials, {trials} of {needed}', None
    return text, holds


def trials_for_percent(percent: float) -> int:
    """
    Return the trials that a bound on a share in % needs: ten are expected on its rarer side.

    With fewer, the share of a run is not near enough to normal, nor fine enough, to be compared.
    """
    rarer = min(percent, 100 - percent) / 100
    if not rarer:
        raise ValueError('no number of trials is enough for a bound of 0 or 100 %')
    return math.ceil(10 / rarer)


def combined(checks: Iterable[Check], separator: str = '; ') -> Check:
    """Return several checks as one; without any it holds."""
    checks = list(checks)
    return separator.join(text for text, _ in checks), all(holds for _, holds in checks)


def share_below(count: int, of: int) -> float:
    """Return the 95 % upper limit of a probability, of count cases in so many: Clopper-Pearson."""
    from scipy.special import betaincinv
    return float(betaincinv(count + 1, of - count, 0.95)) if count < of else 1.0


def mean_chi_square_bounds(degrees: int, count: int) -> tuple[float, float]:
    """Return the 95 % bounds of the mean of count chi-square values, degrees of freedom each."""
    # Here, since a demo imports this file before it starts its nodes.
    from scipy.special import chdtri
    low, high = chdtri(degrees * count, (0.975, 0.025)) / count
    return float(low), float(high)
