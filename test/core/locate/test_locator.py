# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Two observers aligned in time, with light that takes its time and aberration."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skies import CAMERA, START_NS
from startracker_ros.core.astro.aberration import aberrate
from startracker_ros.core.astro.earth import earth_velocity_m_s
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.orbit import CircularOrbit, orbit_frame, propagate
from startracker_ros.core.locate.location import LocationOptions
from startracker_ros.core.locate.locator import Located, Rejected, TargetLocator
from startracker_ros.core.locate.observer import Observer, ObserverOptions, State
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

ORBITS = [CircularOrbit(7.078e6, *np.radians([30.0, 40.0, latitude])) for latitude in (58., 62.)]
TARGET = CircularOrbit(7.468e6, *np.radians([30.5, 40.0, 60.0])).at(0.0)
SIGMA_PX, SIGMA_RAD = 0.05, 5 * ARCSEC
LIGHT_M_S = 299_792_458.0


def target_at(time_s):
    return propagate(*TARGET, time_s)[0]


def seen_from(orbit, time_s, *, aberration='target'):
    """
    Return pixel and attitude that a camera pointed at the target measures.

    aberration is that of ObserverOptions which corrects it.
    """
    position, velocity = orbit.at(time_s)
    line = target_at(time_s) - position
    for _ in range(0 if aberration == 'none' else 3):
        line = target_at(time_s - np.linalg.norm(line) / LIGHT_M_S) - position
    direction = line / np.linalg.norm(line)
    # Fixed to the orbit frame, a degree off the direction of the target at time 0.
    start = orbit.at(0.0)
    axis = orbit_frame(*start).T @ (TARGET[0] - start[0])
    z = orbit_frame(position, velocity) @ (axis / np.linalg.norm(axis) + [0.01, 0.02, 0.0])
    z /= np.linalg.norm(z)
    x = np.cross(velocity, position)
    x -= z * (z @ x)
    x /= np.linalg.norm(x)
    attitude = Rotation.from_matrix(np.stack([x, np.cross(z, x), z], -1))
    measured = attitude
    if aberration != 'none':
        direction = aberrate(direction[None], velocity)[0]
    if aberration == 'stars_and_target':
        earth = earth_velocity_m_s(epoch_year_from_stamp(START_NS))
        turn = np.cross(z, aberrate(z[None], velocity + earth)[0])
        measured = Rotation.from_rotvec(turn).inv() * attitude
    uv = CAMERA.project(attitude.inv().apply(direction))
    assert CAMERA.contains(uv)
    return uv, measured.as_quat()


def add_frame(observer, orbit, time_s, rng=None, *, aberration='target', odometry=True,
              clock_s=0.0):
    """Add all inputs of one frame to an observer, with noise if there is an rng."""
    stamp_ns = START_NS + round((time_s + clock_s) * 1e9)
    uv, quaternion = seen_from(orbit, time_s, aberration=aberration)
    position, velocity = orbit.at(time_s)
    if rng is not None:
        uv = uv + rng.normal(0, SIGMA_PX, 2)
        quaternion = (Rotation.from_rotvec(rng.normal(0, SIGMA_RAD, 3))
                      * Rotation.from_quat(quaternion)).as_quat()
        position = position + rng.normal(0, 10.0, 3)
    if odometry:
        observer.add_state(stamp_ns, State(position, velocity, np.eye(3) * 100.0))
    observer.add_target(stamp_ns, uv, SIGMA_PX)
    observer.add_attitude(stamp_ns, quaternion, np.eye(3) * SIGMA_RAD ** 2)


def locator(**options):
    made = TargetLocator(('tracker_1', 'tracker_2'), ObserverOptions(**options))
    for one in made.observers:
        one.camera = CAMERA
    return made


def error_m(located):
    return located.location.position_m - target_at((located.stamp_ns - START_NS) * 1e-9)


def test_the_velocity_of_an_unknown_date_is_in_the_covariance():
    """Of stars without their aberration, at stamps since boot."""
    one, _ = locator(aberration='stars_and_target').observers
    add_frame(one, ORBITS[0], 0.0, aberration='stars_and_target', clock_s=100 - START_NS * 1e-9)
    line = one.lines.at(one.lines.newest_ns).line
    true = target_at(0.0) - ORBITS[0].at(0.0)[0]
    error = line.direction - true / np.linalg.norm(true)
    sigma_arcsec = np.sqrt(np.linalg.eigvalsh(line.covariance[3:, 3:])[1:]) / ARCSEC
    assert sigma_arcsec.min() > 12 and sigma_arcsec.max() < 14
    assert np.linalg.norm(error) / ARCSEC < 3 * sigma_arcsec.min()


@pytest.mark.parametrize('later_s', [0.0, 0.2])
@pytest.mark.parametrize('aberration', ['target', 'stars_and_target', 'none'])
def test_position_at_the_stamp_without_noise(later_s, aberration):
    """Aberration, light time and the frames between those of the other cost millimetres."""
    made = locator(aberration=aberration)
    results = []
    for frame in range(12):
        add_frame(made.observers[0], ORBITS[0], frame * 0.5, aberration=aberration)
        add_frame(made.observers[1], ORBITS[1], frame * 0.5 + later_s,
                  aberration=aberration)
        results += made.solve()
    located = [one for one in results if isinstance(one, Located)]
    # The first frame has no frame of the other before it.
    assert len(located) == (12 if later_s == 0 else 11)
    assert [one.stamp_ns for one in located] == [
        START_NS + 500_000_000 * frame for frame in range(12)][-len(located):]
    errors = [np.linalg.norm(error_m(one)) for one in located[2:]]
    assert max(errors) < (0.03 if aberration == 'none' else 0.15)


def test_what_aberration_and_light_time_are_worth():
    made = locator(aberration='none')
    for frame in range(4):
        for one, orbit in zip(made.observers, ORBITS):
            add_frame(one, orbit, frame * 0.5, aberration='stars_and_target')
    assert np.linalg.norm(error_m(made.solve()[-1])) > 30


@pytest.mark.slow
def test_errors_are_those_of_the_covariance():
    """Normalised error squared over frames of an interpolating locator."""
    squared = []
    for seed in range(60):
        rng, made = np.random.default_rng(seed), locator(timing_sigma_s=0.0)
        for frame in range(4):
            for one, orbit in zip(made.observers, ORBITS):
                add_frame(one, orbit, frame * 0.5, rng)
        located = [one for one in made.solve() if isinstance(one, Located)]
        squared += [error_m(one) @ np.linalg.solve(one.location.covariance_m2, error_m(one))
                    for one in located[2:]]
    low, high = mean_chi_square_bounds(3, len(squared))
    assert low < np.mean(squared) < high, (low, np.mean(squared), high)


@pytest.mark.slow
def test_covariance_of_interpolated_frames_is_not_too_small():
    squared = []
    for seed in range(60):
        rng, made = np.random.default_rng(seed), locator(timing_sigma_s=0.0)
        for frame in range(4):
            add_frame(made.observers[0], ORBITS[0], frame * 0.5, rng)
            add_frame(made.observers[1], ORBITS[1], frame * 0.5 + 0.25, rng)
        located = [one for one in made.solve() if isinstance(one, Located)]
        squared += [error_m(one) @ np.linalg.solve(one.location.covariance_m2, error_m(one))
                    for one in located[1:]]
    # That of an interpolated line is the mean of both: too large.
    low, high = mean_chi_square_bounds(3, len(squared))
    assert low / 2 < np.mean(squared) < high, (low / 2, np.mean(squared), high)


def test_one_observer_silent():
    made = locator(max_lag_s=1.0)
    for frame in range(5):
        add_frame(made.observers[0], ORBITS[0], frame * 0.5)
    results = made.solve()
    # What may still come is waited for, the rest is given up.
    assert [one.stamp_ns for one in results] == [START_NS, START_NS + 500_000_000]
    assert all(one.reason == 'tracker_2: no odometry' for one in results)
    made = locator()
    for frame in range(5):
        add_frame(made.observers[1], ORBITS[1], frame * 0.5)
    assert made.solve()[0].reason == 'tracker_1: no odometry'
    assert made.solve() == []
    assert made.missing_inputs() == 'tracker_1: no odometry'


@pytest.mark.parametrize('later_s', [100.0, -100.0])
def test_clocks_apart(later_s):
    made = locator(max_lag_s=1.0)
    for frame in range(5):
        add_frame(made.observers[0], ORBITS[0], frame * 0.5)
        add_frame(made.observers[1], ORBITS[1], frame * 0.5, clock_s=later_s)
    results = made.solve()
    assert results and all(isinstance(one, Rejected) for one in results)
    assert any('apart' in one.reason or 'within 1 s' in one.reason for one in results)


def test_frames_too_far_apart_are_not_bridged():
    made = locator(max_gap_s=0.4)
    for frame in range(5):
        add_frame(made.observers[0], ORBITS[0], frame * 0.5)
        add_frame(made.observers[1], ORBITS[1], frame * 0.5 + 0.25)
    assert all('tracker_2: no two lines of sight within 0.4 s' in one.reason
               for one in made.solve()[1:4])


def test_lines_that_do_not_meet_are_rejected():
    made = locator()
    for frame in range(2):
        add_frame(made.observers[0], ORBITS[0], frame * 0.5)
        add_frame(made.observers[1], ORBITS[1], frame * 0.5)
        stamp_ns = START_NS + frame * 500_000_000
        uv, _ = seen_from(ORBITS[1], frame * 0.5)
        # Image right is across the plane of both lines.
        made.observers[1].add_target(stamp_ns, uv + [40.0, 0.0], SIGMA_PX)
    assert all('do not point to one target' in one.reason for one in made.solve())


def test_observers_at_one_position_are_rejected():
    made = TargetLocator(('a', 'b'), location_options=LocationOptions())
    for one in made.observers:
        one.camera = CAMERA
        add_frame(one, ORBITS[0], 0.0)
    assert 'observers 0 m apart' in made.solve()[0].reason


def test_inputs_in_any_order_and_odometry_between_frames():
    observer = Observer('tracker_1')
    observer.camera = CAMERA
    add_frame(observer, ORBITS[0], 1.0, odometry=False)
    assert observer.lines.newest_ns is None
    assert observer.missing_input() == 'tracker_1: no odometry'
    for time_s in (0.7, 1.4):
        observer.add_state(START_NS + round(time_s * 1e9),
                           State(*ORBITS[0].at(time_s), np.zeros((3, 3))))
    observed = observer.line_at(START_NS + 1_000_000_000)
    assert np.linalg.norm(observed.line.position_m - ORBITS[0].at(1.0)[0]) < 1e-3
    # Zeros stand for a covariance that is not known.
    np.testing.assert_allclose(observed.line.covariance[:3, :3], 100.0 * np.eye(3))
    assert observer.state_at(START_NS + 1_500_000_000) is None


def test_time_that_goes_back_starts_anew():
    made = locator()
    for begin_s in (10.0, 0.0):
        for frame in range(3):
            for one, orbit in zip(made.observers, ORBITS):
                add_frame(one, orbit, begin_s + frame * 0.5)
        assert sum(isinstance(one, Located) for one in made.solve()) == 3
