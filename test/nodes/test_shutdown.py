# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Processes end on SIGINT and SIGTERM with exit code 0, whatever they are doing."""

import signal
import subprocess
import sys
import time

from limits import HANGS_S
import pytest
from startracker_ros.ros.processes import node_command

NUMBERS = (signal.SIGINT, signal.SIGTERM)
# The executor adds the entities of a node just after the node logs that it is ready.
DELAYS_S = (0.0, 0.001, 0.003, 0.01)


def script(*lines):
    """Run lines after the handlers are installed; return what they print."""
    start = ('import os, signal, threading, time',
             'from startracker_ros.ros.shutdown import Shutdown',
             'shutdown, woken = Shutdown(), threading.Event()')
    done = subprocess.run([sys.executable, '-c', '\n'.join((*start, *lines))],
                          stdout=subprocess.PIPE, text=True, timeout=HANGS_S, check=True)
    return done.stdout.split()


@pytest.mark.parametrize('number', NUMBERS, ids=lambda number: number.name)
def test_an_early_signal_ends_the_loop(number):
    assert script(
        f'os.kill(os.getpid(), {number:d})',
        'with shutdown.while_spinning(woken.set):',
        '    while not shutdown.requested: time.sleep(0.01)',
        f'os.kill(os.getpid(), {number:d})',
        'print(woken.wait(300))') == ['True']


def test_a_node_may_request_shutdown():
    assert script(
        'with shutdown.while_spinning(woken.set):',
        '    shutdown.request()',
        '    print(woken.wait(300), shutdown.requested)') == ['True', 'True']


@pytest.mark.parametrize('number', NUMBERS, ids=lambda number: number.name)
def test_a_long_callback_is_interrupted(number):
    assert script(
        'try:',
        '    with shutdown.while_spinning(woken.set):',
        '        begin_s = time.monotonic()',
        f'        os.kill(os.getpid(), {number:d})',
        '        while True: time.sleep(0.01)',
        'except KeyboardInterrupt:',
        '    print(time.monotonic() - begin_s > 0.9)',
        f'os.kill(os.getpid(), {number:d})',
        'print("closed")') == ['True', 'closed']


@pytest.mark.parametrize('number', NUMBERS, ids=lambda number: number.name)
def test_a_node_that_has_just_started_ends_cleanly(nodes, tmp_path, number):
    for index, delay_s in enumerate(DELAYS_S):
        process = nodes.run(f'{index}', node_command('attitude_estimator'))
        log = tmp_path / f'{index}.log'
        while 'ready' not in log.read_text() and process.poll() is None:
            time.sleep(0.001)
        time.sleep(delay_s)
        process.send_signal(number)
        assert process.wait(HANGS_S) == 0, log.read_text()
