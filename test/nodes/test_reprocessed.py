# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bag through the nodes and the same bag reprocessed: the same topics with the same content."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
import numpy as np
import pytest
from queues import deep_queues
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu
from startracker_ros.core.maths.rotation import attitude_error
from startracker_ros.core.stages.parameters import StarTrackerOptions
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.ros.messages.attitude import tracked_attitude_from_imu
from startracker_ros.ros.messages.message_types import message_class
from startracker_ros.tools.reprocess import run
from startracker_ros.tools.reprocess.output import chosen_topics
from startracker_ros.tools.reprocess.parameters import ParameterSet
from startracker_ros.tools.reprocess.plan import SegmentOptions

BAG = Path(__file__).parents[2] / 'bags' / 'slew'


@pytest.fixture(scope='module')
def reprocessed(tmp_path_factory):
    """Return the messages of the bag reprocessed, by topic and stamp of its frames."""
    folder = tmp_path_factory.mktemp('run')
    run.reprocess(run.Request(
        [str(BAG)], folder, segments=SegmentOptions(), bag_topics=chosen_topics(['*']),
        sets=[ParameterSet('', StarTrackerOptions(), {})], smooth=False, source=''), workers=1)
    bag, = (path.parent for path in (folder / 'bags').rglob('metadata.yaml'))
    found = {}
    for record in read_messages(bag):
        found.setdefault(record.topic.rpartition('/')[2], {})[record.log_time_ns] = (
            deserialize_message(record.data, message_class(record.type_name)))
    return found


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_replay_and_reprocessing_agree(nodes, probe, reprocessed):
    probe.collect(DiagnosticArray, 'tracker_status', 100)
    probe.collect(Imu, 'attitude_imu', 100)
    probe.collect(Vector3Stamped, 'protection_level', 100)
    player = nodes.start('bag_player', {
        'path': str(BAG), 'topics': ['*/image_raw', '*/camera_info', '*/imu', '*/odometry'],
        'wait_for_camera_users': 4, 'wait_limit_s': 300.0, 'start_delay_s': 2.0})
    nodes.start('composed_pipeline', {'autostart': False} | deep_queues(
        '/image_raw.subscription'))
    nodes.start('pipeline_manager')
    probe.wait(lambda: player.poll() is not None, 'the end of the bag')
    probe.wait(lambda: len(probe.received['attitude_imu']) == len(
        reprocessed['attitude_imu']), 'answers to all frames')
    replayed = {ns_from_stamp(array.header.stamp): array.status[0]
                for array in probe.received['tracker_status']}
    assert replayed.keys() - {0} <= reprocessed['tracker_state'].keys()
    imu = {ns_from_stamp(message.header.stamp): message
           for message in probe.received['attitude_imu']}
    assert imu.keys() == reprocessed['attitude_imu'].keys()
    bounds = {ns_from_stamp(message.header.stamp): message.vector
              for message in probe.received['protection_level']}
    assert bounds.keys() == {stamp_ns for stamp_ns, message in imu.items()
                             if message.orientation_covariance[0] != -1}
    # An identification ends some frames later in the nodes: the same stars are tracked in the end.
    last = sorted(replayed)[-10:]
    ours, other = (np.array([[vector.x, vector.y, vector.z] for vector in vectors])
                   for vectors in zip(*((bounds[stamp_ns], reprocessed[
                       'protection_level'][stamp_ns].vector) for stamp_ns in last)))
    # Some stars differ; where one of them doubts the motion of a frame its bound is far wider.
    np.testing.assert_allclose(np.median(ours / other, axis=0), 1, atol=0.2)
    apart = []
    for stamp_ns in last:
        ours, other = replayed[stamp_ns], reprocessed['tracker_state'][stamp_ns]
        assert (ours.name, ours.level, ours.message) == (other.name, other.level, 'TRACKING')
        ours, other = values(ours), values(other)
        # Behind them are those of the blinding to come, of which reprocessing has no limits.
        assert [*ours][:len(other)] == [*other]
        for name in ('frames_since_fix', 'late_frames', 'rejected_centroids', 'gyro',
                     'stamp_sigma_ms'):
            assert ours[name] == other[name]
        assert abs(int(ours['stars_matched']) - int(other['stars_matched'])) <= 2
        assert abs(float(ours['residual_px']) - float(other['residual_px'])) < 0.01
        ours, other = (tracked_attitude_from_imu(messages[stamp_ns]).attitude
                       for messages in (imu, reprocessed['attitude_imu']))
        error = attitude_error(ours.quaternion, other.quaternion)
        apart.append(error @ np.linalg.solve(ours.covariance_sensor, error))
    # Of 30 stars one more at a gate of 5 sigma moves the attitude by 25 x 3 / 30.
    assert np.median(apart) < 0.2 and max(apart) < 2.5
