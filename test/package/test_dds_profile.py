# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped Fast DDS profile is in force in a process that is started with it."""

import os
from pathlib import Path
import re
import subprocess
import sys

from limits import HANGS_S
import pytest
from startracker_ros.ros.memory import choose_segment, profile_variable, PROFILE_VARIABLES
from startracker_ros.ros.processes import node_environment, take_domain

PROFILE = Path(__file__).parents[2] / 'config' / 'fastdds.xml'
SEGMENT_BYTES = 64 << 20
# Makes a participant and prints the size of its shared-memory segment, which it holds the lock of:
# those of others that it finds, as of a node that is about to end, are mapped as well.
PROGRAM = """
import os
import rclpy
rclpy.init()
node = rclpy.create_node('profile_probe')
held = [os.readlink(entry.path) for entry in os.scandir('/proc/self/fd')]
maps = [line.split() for line in open('/proc/self/maps')]
ranges = [words[0].split('-') for words in maps if f'{words[-1]}_el' in held]
print(max(int(end, 16) - int(begin, 16) for begin, end in ranges))
"""


@pytest.mark.parametrize('profile, enough', [(PROFILE, True), (None, False)],
                         ids=['shipped', 'stock'])
def test_segment_holds_images(profile, enough):
    environment = {name: value for name, value in os.environ.items()
                   if name not in PROFILE_VARIABLES}
    environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    environment['ROS_DOMAIN_ID'] = take_domain()
    if profile:
        environment[profile_variable()] = str(profile)
    done = subprocess.run([sys.executable, '-c', PROGRAM], env=environment,
                          capture_output=True, text=True, timeout=HANGS_S)
    assert done.returncode == 0, done.stderr
    # A port that another participant opens at the same moment is an error in the log as well, and
    # Fast DDS takes the next one.
    assert not [line for line in (done.stdout + done.stderr).splitlines()
                if 'Error' in line and 'open_and_lock_file failed' not in line]
    assert (int(done.stdout.split()[-1]) >= SEGMENT_BYTES) == enough


@pytest.mark.parametrize('variable', PROFILE_VARIABLES)
def test_nodes_without_images_take_the_profile_with_the_smaller_segment(monkeypatch, variable):
    small = PROFILE.with_name('fastdds_lists.xml')
    for name in PROFILE_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for sends_images, used in ((True, PROFILE), (False, small)):
        monkeypatch.setenv(variable, str(PROFILE))
        choose_segment(sends_images)
        assert os.environ[variable] == str(used)
    # A profile of the user stays.
    monkeypatch.setenv(variable, 'mine.xml')
    choose_segment(False)
    assert os.environ[variable] == 'mine.xml'
    environment = node_environment()
    assert [environment[name] for name in PROFILE_VARIABLES if name in environment] == ['mine.xml']
    # Otherwise the two are the same.
    texts = [re.sub('(?s)<!--.*?-->', '', file.read_text(), count=1) for file in (PROFILE, small)]
    sizes = [[int(re.search(f'<{name}>(.*?)<', text).group(1))
              for name in ('maxMessageSize', 'segment_size')] for text in texts]
    assert sizes[1] < sizes[0] and all(message < segment for message, segment in sizes)
    assert len({re.sub('<(maxMessageSize|segment_size)>.*?<', '', text) for text in texts}) == 1
