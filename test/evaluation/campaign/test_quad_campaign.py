"""The quad campaign: what it prints holds, and it can be repeated."""

import json

from click.testing import CliRunner
import numpy as np
from startracker_ros.__main__ import main
from startracker_ros.evaluation.campaign.quad import CAMERA, orbit_frames, sky_frames


def test_the_command_prints_the_figures_beside_those_of_the_paper():
    done = CliRunner().invoke(main, ['campaign', 'quad', '--trials', '20', '--json'])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    rows = {row['case']: row for row in document['rows']}
    assert all(row['holds'] for row in rows.values())
    assert rows['database: stars']['paper'] == 2827
    assert rows['database: pairs']['paper'] == 269421
    assert rows['orbit: identified']['ours'] == rows['orbit: identified']['paper'] == 100
    assert rows['orbit: wrong']['ours'] == rows['whole sky: wrong']['ours'] == 0
    assert rows['orbit: time, mean']['paper'] == 72.6
    assert rows['orbit: time, worst']['paper'] == 128.6
    assert document['conditions']['trials'] == 20


def test_frames_can_be_repeated():
    def figures(frames):
        return [(frame.solved, frame.stars, frame.identified, frame.triangles) for frame in frames]

    assert figures(sky_frames(4, 7)) == figures(sky_frames(4, 7))
    assert figures(orbit_frames(10, 3, 7)) == figures(orbit_frames(10, 3, 7))


def test_fields_are_those_of_the_paper():
    assert np.degrees(CAMERA.fov_x_rad) == np.degrees(CAMERA.fov_y_rad)
    assert abs(np.degrees(CAMERA.fov_x_rad) - 20.3) < 1e-9
    assert all(13 <= frame.stars <= 24 for begin in range(0, 300, 60)
               for frame in orbit_frames(begin, 2, 1))
