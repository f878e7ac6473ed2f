# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which velocity aberration is computed from, and what is done with wrong input."""

from dataclasses import replace

import numpy as np
import pytest
from startracker_ros.core.astro.earth import earth_velocity_m_s
from startracker_ros.core.astro.epoch import (
    catalogue_epoch, CatalogueEpoch, epoch_year_from_stamp, stamp_from_epoch_year, why_no_date)
from startracker_ros.core.astro.observer_motion import (
    AberrationOptions, EARTH_SIGMA_M_S, KNOWN_SIGMA_M_S, MotionError, ObserverMotion,
    ORBIT_SIGMA_M_S)
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.astro.state import State

STAMP_NS = stamp_from_epoch_year(2026.4)
ORBIT = CircularOrbit(7.078e6, *np.radians([30.0, 40.0, 60.0]))
ELEMENTS = (7078.0, 0.0, 30.0, 40.0, 0.0, 60.0)


def state(time_s=0.0):
    return State(*ORBIT.at(time_s), np.zeros((3, 3)))


def velocity(observer, stamp_ns=STAMP_NS):
    return observer.state.velocity_m_s - earth_velocity_m_s(epoch_year_from_stamp(stamp_ns))


def test_full_needs_odometry():
    motion = ObserverMotion()
    before = motion.at(STAMP_NS)
    assert (before.used, before.condition) == ('earth_only', 'earth_only (no odometry)')
    assert before.velocity_sigma_m_s == ORBIT_SIGMA_M_S and not before.trouble
    assert np.linalg.norm(velocity(before)) < 0.1
    motion.add_state(STAMP_NS, state())
    after = motion.at(STAMP_NS)
    assert (after.condition, after.velocity_sigma_m_s) == ('full', KNOWN_SIGMA_M_S)
    assert np.linalg.norm(velocity(after) - ORBIT.at(0.0)[1]) < 0.1


@pytest.mark.parametrize('time_s', [-30.0, 0.05, 600.0])
def test_odometry_is_propagated_to_the_stamp(time_s):
    motion = ObserverMotion()
    motion.add_state(STAMP_NS, state())
    stamp_ns = STAMP_NS + round(time_s * 1e9)
    # J2 and the steps of 10 s of the velocity of the Earth.
    assert np.linalg.norm(velocity(motion.at(stamp_ns), stamp_ns) - ORBIT.at(time_s)[1]) < 10


def test_the_ground_does_not_fall():
    motion = ObserverMotion()
    site = State(np.array([6.378e6, 0.0, 0.0]), np.array([0.0, 465.0, 0.0]), np.zeros((3, 3)))
    motion.add_state(STAMP_NS, site)
    later_ns = STAMP_NS + 60 * 10 ** 9
    assert np.linalg.norm(velocity(motion.at(later_ns), later_ns) - site.velocity_m_s) < 0.1


def test_old_odometry_is_named_and_not_used():
    motion = ObserverMotion()
    motion.add_state(STAMP_NS - 3 * 3600 * 10 ** 9, state())
    observer = motion.at(STAMP_NS)
    assert observer.condition == 'earth_only (odometry is 3.0 h off)' and observer.trouble
    assert observer.velocity_sigma_m_s == ORBIT_SIGMA_M_S


@pytest.mark.parametrize('wrong, reason', [
    (state()._replace(velocity_m_s=np.array([0.0, 21e3, 0.0])), '21.0 km/s about the Earth'),
    (state()._replace(velocity_m_s=np.array([np.nan, 0.0, 0.0])), 'nan km/s'),
    (state()._replace(position_m=np.array([0.0, 0.0, 7000.0])), '7 km from the centre')])
def test_impossible_odometry_is_rejected(wrong, reason):
    motion = ObserverMotion()
    motion.add_state(STAMP_NS, state())
    with pytest.raises(MotionError, match=reason):
        motion.add_state(STAMP_NS + 1, wrong)
    assert motion.at(STAMP_NS).used == 'full'


NOW_S = 1_790_000_000


@pytest.mark.parametrize('stamp_s, words', [
    (0, 'stamp 0: the driver does not stamp'),
    (100, 'stamps of 1970: the driver stamps since boot'), (9e7, 'since boot'),
    (NOW_S - 946_728_000 - 64, 'seconds since 2000'), (NOW_S - 315_964_800 + 18, 'GPS time'),
    (NOW_S + 378_691_200 + 37, 'TAI of seconds since 1958'),
    (946_684_799, 'stamps of 1999 are not UTC'), (-1e6, 'stamps of 1969 are not UTC'),
    (4.15e9, 'stamps of 2101 are not UTC')])
def test_the_date_of_another_clock_is_unknown(stamp_s, words):
    """Of GPS time and TAI it is recognised by the time at which the message comes."""
    stamp_ns = round(stamp_s * 1e9)
    epoch = catalogue_epoch(stamp_ns, NOW_S * 10 ** 9 + 5 * 10 ** 7)
    assert words in why_no_date(stamp_ns, epoch.other_clock)
    assert abs(epoch.year - 2026.7) < epoch.sigma_years and epoch.sigma_years > 10
    assert 'the date is unknown' in str(epoch)
    motion = ObserverMotion(epoch=epoch)
    motion.add_state(stamp_ns, state())
    observer = motion.at(stamp_ns)
    assert observer.state is None and observer.bodies is None and observer.trouble
    assert observer.velocity_sigma_m_s == EARTH_SIGMA_M_S
    assert observer.epoch_sigma_years == epoch.sigma_years
    # One text for a whole run, of which a log has one line.
    assert motion.at(stamp_ns + 30 * 10 ** 9).condition == (
        f'none ({why_no_date(stamp_ns or 1, epoch.other_clock)})')
    # A sky without aberration has no date that matters but for the places of stars.
    still = ObserverMotion(AberrationOptions(aberration='none'), epoch).at(stamp_ns)
    assert (still.velocity_sigma_m_s, still.trouble) == (0.0, False)
    assert still.epoch_sigma_years == epoch.sigma_years


def test_a_stamp_of_any_date_is_one_whenever_it_comes():
    """A recording is played years later, a simulation is of a later year."""
    for year in (2000.1, 2015.0, 2026.5, 2040.0, 2099.9):
        stamp_ns = stamp_from_epoch_year(year)
        epoch = catalogue_epoch(stamp_ns, NOW_S * 10 ** 9)
        assert epoch == (pytest.approx(year), 0.0, '') and str(epoch) == f'epoch J{year:.2f}'
        assert ObserverMotion(epoch=epoch).at(stamp_ns).used == 'earth_only'


def test_stamps_of_another_year_than_that_of_the_stars_are_named():
    motion = ObserverMotion(epoch=CatalogueEpoch(2026.7))
    observer = motion.at((NOW_S - 315_964_782) * 10 ** 9)
    assert observer.reason.startswith('stamps of 2016, but the stars are of epoch J2026.7')
    assert observer.velocity_sigma_m_s == EARTH_SIGMA_M_S and observer.trouble


def test_the_mode_is_that_of_the_parameter():
    for mode, sigma in (('earth_only', ORBIT_SIGMA_M_S), ('none', 0.0)):
        motion = ObserverMotion(AberrationOptions(aberration=mode))
        motion.add_state(STAMP_NS, state())
        observer = motion.at(STAMP_NS)
        assert (observer.condition, observer.velocity_sigma_m_s) == (mode, sigma)
        assert (observer.state is None) == (mode == 'none')


def test_elements_take_the_place_of_odometry():
    options = AberrationOptions(orbit_elements=ELEMENTS, orbit_epoch_s=STAMP_NS * 1e-9)
    motion = ObserverMotion(options)
    assert motion.at(STAMP_NS).used == 'full'
    assert np.linalg.norm(velocity(motion.at(STAMP_NS)) - ORBIT.at(0.0)[1]) < 0.1
    old = ObserverMotion(replace(options, orbit_epoch_s=1e9)).at(STAMP_NS)
    assert old.used == 'earth_only' and 'days off' in old.reason and old.trouble


def test_elements_of_another_planet_are_named_and_not_used():
    observer = ObserverMotion(AberrationOptions(
        orbit_elements=(3796.0, 0.0, 30.0, 40.0, 0.0, 60.0),
        orbit_epoch_s=STAMP_NS * 1e-9)).at(STAMP_NS)
    assert observer.used == 'earth_only' and observer.trouble
    assert 'no orbit about the Earth' in observer.reason
