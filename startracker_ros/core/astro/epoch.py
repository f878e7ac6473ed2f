# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stamps, UNIX time in ns, and Julian years."""

from datetime import date, datetime, timedelta, UTC
from numbers import Integral, Real
import time
from typing import Any

from startracker_ros.core.astro.constants import DAYS_PER_YEAR, YEAR_S

RESTART_NS = 1_000_000_000
"""Stamps that step back by more come from a restarted simulation or a looped bag."""

EPOCHS = 1800.0, 2200.0
"""Julian years to which the catalogue is propagated."""

_J2000_NS = 946_728_000 * 10 ** 9
_YEAR_NS = round(YEAR_S) * 10 ** 9
# In ns, and days with the one on which J2000 is.
_UNIX_UNITS = {'s': 10 ** 9, 'ms': 10 ** 6, 'us': 1000, 'ns': 1}
_DAY_COUNTS = {'Julian date': 2451545.0, 'modified Julian date': 51544.5}
# Who takes one unit for another has data of these years.
_LIKELY_YEARS = 1980.0, 2100.0


def epoch_year_from_stamp(stamp_ns: int) -> float:
    """
    Return the Julian year of a UNIX time in ns.

    UTC serves as Terrestrial Time: in the minute between them no star moves by 0.1 mas.
    """
    return 2000.0 + (stamp_ns - _J2000_NS) / _YEAR_NS


def stamp_from_epoch_year(year: float) -> int:
    """Return the UNIX time in ns of a Julian year, the inverse of epoch_year_from_stamp()."""
    return _J2000_NS + round((year - 2000.0) * _YEAR_NS)


def stamp_from_datetime(moment: datetime) -> int:
    """Return the UNIX time in ns, to 1 us, of a time that is UTC where it names no zone."""
    utc = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return round(utc.timestamp() * 1e6) * 1000


def julian_year(epoch: float | datetime | str, name: str = 'epoch') -> float:
    """
    Return the Julian year of an epoch: a year, a time, or either as text, UTC without a zone.

    ValueError for any other type, and for what is in another unit: it says which that may be.
    """
    value: Any = epoch
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            try:
                value = datetime.fromisoformat(value)
            except ValueError:
                raise ValueError(f'{name} = {epoch!r} is neither a year nor a time like '
                                 '2026-11-23T01:30:00') from None
    if isinstance(value, datetime):
        value = epoch_year_from_stamp(stamp_from_datetime(value))
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f'{name} = {value!r} is of type {type(value).__name__}, must be a Julian '
                         'year as 2026.5, a datetime or a text as 2026-11-23')
    year = float(value)
    if not EPOCHS[0] <= year <= EPOCHS[1]:
        raise ValueError(f'{name} = {year:.10g} is no Julian year from {EPOCHS[0]:g} to '
                         f'{EPOCHS[1]:g}, as 2026.5 is{_other_unit(year)}')
    return year


def _other_unit(value: float) -> str:
    """Return what a number that is no Julian year may be, empty where it may be nothing."""
    years = {f'UNIX time in {unit}': 2000.0 + (value * unit_ns - _J2000_NS) / _YEAR_NS
             for unit, unit_ns in _UNIX_UNITS.items()}
    years |= {name: 2000.0 + (value - day) / DAYS_PER_YEAR for name, day in _DAY_COUNTS.items()}
    for name, year in years.items():
        if _LIKELY_YEARS[0] <= year <= _LIKELY_YEARS[1]:
            return f': as a {name} it is {year:.6g}'
    try:
        day = date.fromisoformat(f'{value:.0f}')
    except ValueError:
        return ''
    return f': as a date it is the text {day.isoformat()!r}'


def checked_stamp(stamp_ns: int, epoch_year: float | None = None) -> int:
    """
    Return a stamp as an int; ValueError for a float, which holds no ns of UNIX time.

    Where the epoch is given, also for UNIX time in s: in ns it is in January 1970.
    """
    value: Any = stamp_ns
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise ValueError(f'stamp_ns = {value!r} is of type {type(value).__name__}, must be '
                         'UNIX time in ns as an int: round(seconds * 1e9)')
    stamp_ns = int(value)
    if epoch_year is not None and abs(
            epoch_year_from_stamp(stamp_ns * _UNIX_UNITS['s']) - epoch_year) < 1:
        raise ValueError(f'stamp_ns = {stamp_ns} is {utc(stamp_ns)}: in s it is of the epoch, but '
                         'it must be in ns')
    return stamp_ns


def epoch_year_now() -> float:
    """Return the current Julian year."""
    return epoch_year_from_stamp(time.time_ns())


def utc(stamp_ns: int, *, digits: int = 3) -> str:
    """Return ISO 8601 of UNIX time in ns, digits after the point of the second, cut off."""
    seconds, nanoseconds = divmod(int(stamp_ns), 10 ** 9)
    date = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    return f'{date:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}'[:20 + digits]
