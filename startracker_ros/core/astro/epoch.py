# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Stamps, UNIX time in ns, and Julian years."""

from datetime import datetime, timedelta, UTC
import time

from startracker_ros.core.astro.constants import YEAR_S

RESTART_NS = 1_000_000_000
"""Stamps that step back by more come from a restarted simulation or a looped bag."""

_J2000_NS = 946_728_000 * 10 ** 9
_YEAR_NS = round(YEAR_S) * 10 ** 9


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


def epoch_year_now() -> float:
    """Return the current Julian year."""
    return epoch_year_from_stamp(time.time_ns())


def utc(stamp_ns: int, *, digits: int = 3) -> str:
    """Return ISO 8601 of UNIX time in ns, digits after the point of the second, cut off."""
    seconds, nanoseconds = divmod(int(stamp_ns), 10 ** 9)
    date = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    return f'{date:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09d}'[:20 + digits]
