# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The probe: it repeats what may be lost, and loses nothing itself."""

from itertools import count

from limits import HANGS_S
import pytest
from rclpy.context import Context
from sensor_msgs.msg import CameraInfo
from startracker_ros.ros.probe import Probe
from startracker_ros.ros.processes import HarnessError
from std_msgs.msg import String


def test_it_sends_until_a_condition_is_true(probe):
    numbers, sent = count(1), []
    assert probe.send_until(lambda: sent.append(next(numbers)), lambda: sent[2:], 'three',
                            period_s=0.01) == [3]
    with pytest.raises(HarnessError, match='what never is: not within 0.05 s'):
        probe.send_until(lambda: None, lambda: False, 'what never is', timeout_s=0.05)


def test_messages_wait_for_it(probe):
    """Whatever the depth of the profile, as long as it does not run."""
    probe.collect(String, '/texts', 1)
    publisher = probe.advertise(String, '/texts', 500)
    texts = [str(number) for number in range(300)]
    for text in texts:
        publisher.publish(String(data=text))
    probe.wait(lambda: len(probe.received['/texts']) == len(texts), 'all messages', HANGS_S)
    assert [message.data for message in probe.received['/texts']] == texts


def test_another_message_is_counted(nodes, probe):
    """Not one of before: the count of a node has to increase."""
    nodes.start('camera_calibrator')
    publisher = probe.advertise(CameraInfo, 'camera_info')
    for number in (1, 2):
        probe.publish_until_received(publisher, CameraInfo())
        value = probe.diagnostic_value('camera_calibrator: calibration', 'camera_info received')
        assert value is not None and int(value) >= number


def test_sigterm_ends_it_as_ctrl_c_does():
    """Both end the context of rclpy."""
    context = Context()
    context.init()
    probe = Probe('ended', context=context)
    context.shutdown()
    with pytest.raises(KeyboardInterrupt):
        probe.spin_once(1.0)
