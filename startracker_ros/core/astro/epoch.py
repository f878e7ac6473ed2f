# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stamps, UNIX time in ns, and Julian years."""

from datetime import date, datetime, timedelta, UTC
from numbers import Integral, Real
import time
from typing import Any, NamedTuple

from startracker_ros.core.astro.constants import (
    DAY_S, DAYS_PER_YEAR, J2000_JD, LAST_YEAR, MJD_JD, UNIX_JD, YEAR_S)

RESTART_NS = 1_000_000_000
"""Stamps that step back by more come from a restarted simulation or a looped bag."""

NOT_STAMPED = ('stamp 0: the driver does not stamp its messages: let it stamp each with the time '
               'of the middle of the exposure, in UTC')

EPOCHS = 1800.0, 2200.0
"""Julian years to which the catalogue is propagated."""

FIRST_DATE_YEAR = 2000.0
"""No camera with a driver of today took images before: an earlier stamp is of another clock."""

_J2000_S = round((J2000_JD - UNIX_JD) * DAY_S)
_J2000_NS = _J2000_S * 10 ** 9
_YEAR_NS = round(YEAR_S) * 10 ** 9
_LONGEST_UPTIME_YEARS = 10.0
_NEAR_YEARS = 0.05
"""No star of the catalogue moves by more than 0.2 arcsec in this time."""
# Where the seconds of other clocks are zero, in UNIX time. TAI and GPS time have no leap seconds:
# 37 and 18 since 2017 (IERS Bulletin C 52 and later).
_OTHER_ZEROS_S = {
    'GPS time, of seconds since 1980': 315_964_800 - 18,
    'TAI of seconds since 1958': -378_691_200 - 37,
    'seconds since 2000': _J2000_S}
_ZERO_TOLERANCE_S = 3600.0
"""How late a message may be for its clock to be recognised."""
_UTC_HINT = 'let it stamp in UTC since 1970, which gives the velocity of the Earth'
# In ns, and days with the one on which J2000 is.
_UNIX_UNITS = {'s': 10 ** 9, 'ms': 10 ** 6, 'us': 1000, 'ns': 1}
_DAY_COUNTS = {'Julian date': J2000_JD, 'modified Julian date': J2000_JD - MJD_JD}
# Who takes one unit for another has data of these years.
_LIKELY_YEARS = 1980.0, 2100.0


def epoch_year_from_stamp(stamp_ns: int) -> float:
    """
    Return the Julian year of a UNIX time in ns.

    UTC serves as Terrestrial Time: in the minute between them no star moves by 0.1 mas.
    """
    return 2000.0 + (stamp_ns - _J2000_NS) / _YEAR_NS


class CatalogueEpoch(NamedTuple):
    """
    The Julian year of a catalogue with its 1 sigma in years.

    other_clock is what the stamps count that it was to be taken from, empty where that is UTC or
    not known.
    """

    year: float
    sigma_years: float = 0.0
    other_clock: str = ''

    def is_near(self, other: 'CatalogueEpoch') -> bool:
        """Return whether the stars of another epoch are where they are at this one."""
        return self[1:] == other[1:] and abs(self.year - other.year) <= _NEAR_YEARS

    def __str__(self) -> str:
        if not self.sigma_years:
            return f'epoch J{self.year:.2f}'
        return f'epoch J{self.year:.0f} +- {self.sigma_years:.0f} years, as the date is unknown'


def catalogue_epoch(stamp_ns: int, received_ns: int | None = None) -> CatalogueEpoch:
    """
    Return the epoch of the stars for images of a stamp.

    received_ns is the UNIX time at which its message came, by which clocks that count from
    another time are recognised. Where the date is unknown it is the middle of 2000 to 2050, with
    the standard deviation of a date that may be any of these.
    """
    clock = '' if received_ns is None else _other_clock((received_ns - stamp_ns) * 1e-9)
    if why_no_date(stamp_ns, clock):
        return CatalogueEpoch(2025.0, 25 / 3 ** 0.5, clock)
    return CatalogueEpoch(epoch_year_from_stamp(stamp_ns))


def _other_clock(late_s: float) -> str:
    """Return the clock whose stamps are so late, empty for none."""
    return next((clock for clock, zero_s in _OTHER_ZEROS_S.items()
                 if abs(late_s - zero_s) < _ZERO_TOLERANCE_S), '')


def why_no_date(stamp_ns: int, other_clock: str = '') -> str:
    """
    Return why a stamp is not UTC of a date from 2000 to 2100, and what to do; empty if it is one.

    The text is the same for all stamps of a run.
    """
    if other_clock:
        return f'the driver stamps in {other_clock}, not in UTC: {_UTC_HINT}'
    if not stamp_ns:
        return NOT_STAMPED
    year = epoch_year_from_stamp(stamp_ns)
    if FIRST_DATE_YEAR <= year <= LAST_YEAR:
        return ''
    if 0 <= year - 1970 < _LONGEST_UPTIME_YEARS:
        return (f'stamps of {int(year)}: the driver stamps since boot, not UTC: {_UTC_HINT}; a '
                'simulation may begin at a date, or have no aberration (aberration: none)')
    return (f'stamps of {int(year)} are not UTC of a date from {FIRST_DATE_YEAR:.0f} to '
            f'{LAST_YEAR:.0f}: the driver stamps by another clock: {_UTC_HINT}')


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
        raise ValueError(f'{name} = {year:.10g} is not a Julian year from {EPOCHS[0]:g} to '
                         f'{EPOCHS[1]:g}, as 2026.5 is{_other_unit(year)}')
    return year


def _other_unit(value: float) -> str:
    """Return what a number that is not a Julian year may be, empty where it may be nothing."""
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
