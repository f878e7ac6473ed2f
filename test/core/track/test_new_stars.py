# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""New stars agree with the catalogue in position and magnitude, and with nothing else."""

import numpy as np
from star_motion import CAMERA
from startracker_ros.core.attitude.estimate import AttitudeEstimate
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.maths.rotation import quaternion_from_pointing, rotate
from startracker_ros.core.track.in_view import StarsInView
from startracker_ros.core.track.new_stars import match_new_stars

Q = quaternion_from_pointing(1.0, -0.5, 2.0)
UV = np.array([[100.0, 200], [500, 700], [502, 700], [900, 300], [910, 305]])
MAGNITUDE = np.array([3.0, 4.0, 4.2, 5.0, 8.0])


def match(uv, magnitude, sigma_rad=1e-7, crowded=(False,) * 5, roll_sigma_rad=1e-7,
          variation_mag=(0.0,) * 5):
    onboard = OnboardCatalog(np.arange(1, 6, dtype=np.int32), rotate(Q, CAMERA.unproject(UV)),
                             MAGNITUDE, *np.array([crowded, crowded]),
                             variation_mag=np.array(variation_mag, np.float32))
    attitude = AttitudeEstimate(
        Q, np.diag([sigma_rad, sigma_rad, roll_sigma_rad]) ** 2, 9, np.zeros(9), 9.0)
    uv = np.reshape(uv, (-1, 2))
    flux = 10 ** (0.4 * (20 - np.asarray(magnitude, float)))
    index, centroid = match_new_stars(
        StarsInView(CAMERA, onboard), ApparentCatalog(onboard), attitude, uv, flux,
        np.full(len(uv), 0.1), 20.0, 1.0)
    return sorted(zip(onboard.hip[index].tolist(), centroid.tolist()))


def test_near_and_as_bright():
    assert match([UV[0], UV[3]], [3.3, 4.8]) == [(1, 0), (4, 1)]


def test_too_far_or_of_other_brightness():
    assert match([UV[0] + [0.6, 0]], [3]) == []
    assert match([UV[0] + [0.3, 0]], [3]) == [(1, 0)]
    assert match([UV[0]], [4.5]) == []
    assert match([UV[0]], [np.nan]) == []


def test_a_variable_may_be_of_other_brightness():
    varies = (0.4, 0.0, 0.0, 0.0, 0.0)
    assert match([UV[0]], [4.5], variation_mag=varies) == [(1, 0)]
    assert match([UV[0], UV[3]], [5.0, 6.5], variation_mag=varies) == []


def test_uncertain_attitude_widens_the_search():
    """By 1 mrad of roll the star 500 px from the centre may be off by 0.5 px, not by more."""
    assert match([UV[0] + [1, 0]], [3], roll_sigma_rad=1e-3) == [(1, 0)]
    assert match([UV[0] + [1, 0]], [3], sigma_rad=1e-4) == [(1, 0)]
    assert match([UV[0] + [6, 0]], [3], sigma_rad=1e-2) == []


def test_ambiguous_pairs_are_left_alone():
    assert match([UV[0], UV[0] + 0.2], [3, 3]) == []
    # Halfway between two stars alike, seen through an uncertain attitude.
    assert match([UV[1] + [1, 0]], [4], sigma_rad=1e-4) == []
    assert match([UV[1] + [1, 0]], [3.1], sigma_rad=1e-4) == [(2, 0)]
    # A false point of another brightness beside a star does not make it ambiguous.
    assert match([UV[0], UV[0] + 0.2], [3, 6]) == [(1, 0)]


def test_crowded_star_is_no_partner_but_makes_others_ambiguous():
    crowded = (False, False, True, False, False)
    assert match([UV[2]], [4.2], crowded=crowded) == []
    assert match([UV[1] + [1, 0]], [4], sigma_rad=1e-4, crowded=crowded) == []


def test_nothing_to_match():
    assert match(np.empty((0, 2)), []) == []
