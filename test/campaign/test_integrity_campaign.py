"""A few runs in which a careless tracker would publish a wrong attitude."""

import numpy as np
import pytest
from startracker_ros.campaign.integrity import CONDITIONS, integrity_runs, Tally, tally_of
from startracker_ros.maths.rotation import multiply, quaternion_from_rotation_vector

MISLEADING = ['slews, gyro in deg/s', 'turned away at once', 'planet passing',
              'half of the image covered', 'dark for 2 s at 0.3 deg/s, gyro']


@pytest.mark.parametrize('name', MISLEADING)
def test_nothing_wrong_is_published(name):
    tally = integrity_runs(name, 1, seed=3)
    assert tally.frames == CONDITIONS[name].frames and tally.wrong == 0 and tally.worst < 1
    assert 100 * tally.published >= CONDITIONS[name].needed_percent * tally.frames


@pytest.mark.parametrize('name', ['mirrored image', 'focal length off by 1 %'])
def test_nothing_at_all_is_published_of_a_wrong_camera(name):
    assert integrity_runs(name, 1, seed=4).published == 0


def test_a_wrong_attitude_would_be_counted():
    truth = np.array([0.0, 0.0, 0.0, 1.0])
    covariance = np.eye(3) * 1e-12
    off = multiply(truth, quaternion_from_rotation_vector([0.0, 3.2e-4, 0.0]))
    assert tally_of(truth, covariance, truth) == Tally(published=1)
    assert tally_of(off, covariance, truth).wrong == 1
    assert tally_of(off, covariance * 1e4, truth).wrong == 0
