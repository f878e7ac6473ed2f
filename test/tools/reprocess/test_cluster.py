# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags of an S3 store on a dask cluster of processes over TCP, which are killed in mid-run."""

from contextlib import ExitStack
import json
from pathlib import Path
import socket
import subprocess
import sys
import time

import pytest
from startracker_ros.sim.flights.bags import write_bag
from startracker_ros.sim.flights.options import FlightOptions
from test_reprocess import hashes

pytestmark = pytest.mark.long
HANGS_S = 120
OPTIONS = ('--segment-s', '5', '--overlap-s', '5', '--smooth')
MOTO = (
    'import sys, threading; from moto.server import ThreadedMotoServer; '
    "ThreadedMotoServer(ip_address='127.0.0.1', port=int(sys.argv[1])).start(); "
    'threading.Event().wait()')


def free_port():
    with socket.create_server(('127.0.0.1', 0)) as server:
        return server.getsockname()[1]


def wait_for(condition):
    """Return once the condition holds."""
    end_s = time.monotonic() + HANGS_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def answers(port):
    with socket.socket() as client:
        return client.connect_ex(('127.0.0.1', port)) == 0


class Processes(ExitStack):
    """Processes of this interpreter, killed at the end."""

    def start(self, *arguments):
        """Start one whose errors are among the output of the test."""
        process = subprocess.Popen([sys.executable, *arguments], stdout=subprocess.DEVNULL)
        self.callback(process.wait)
        self.callback(process.kill)
        return process


@pytest.fixture(scope='module')
def object_store():
    """Serve S3 in a process of its own, and let this one and its children use it."""
    port = free_port()
    with Processes() as processes, pytest.MonkeyPatch.context() as patch:
        for name, value in (('ENDPOINT_URL', f'http://127.0.0.1:{port}'), ('ACCESS_KEY_ID', 'a'),
                            ('SECRET_ACCESS_KEY', 'b'), ('DEFAULT_REGION', 'us-east-1')):
            patch.setenv(f'AWS_{name}', value)
        store = processes.start('-c', MOTO, str(port))
        wait_for(lambda: answers(port) or store.poll() is not None)
        assert store.poll() is None
        import s3fs
        yield s3fs.S3FileSystem()


class Cluster:
    """A scheduler and two workers, each a process."""

    def __init__(self, processes, folder):
        self._processes, self._folder = processes, folder
        self.port = free_port()
        self.address = f'tcp://127.0.0.1:{self.port}'
        self.start()

    def start(self):
        """Start the scheduler and two workers."""
        self.scheduler = self._processes.start(
            '-m', 'distributed.cli.dask_scheduler', '--host', '127.0.0.1', '--port',
            str(self.port), '--no-dashboard')
        wait_for(lambda: answers(self.port))
        self.workers = [self._processes.start(
            '-m', 'distributed.cli.dask_worker', self.address, '--nthreads', '1', '--no-nanny',
            '--no-dashboard', '--local-directory', str(self._folder)) for _ in range(2)]

    def kill(self):
        """Kill the scheduler, with which its workers end."""
        self.scheduler.kill()
        for worker in self.workers:
            worker.wait(HANGS_S)


@pytest.fixture
def cluster(tmp_path):
    with Processes() as processes:
        yield Cluster(processes, tmp_path)


@pytest.fixture(scope='module')
def flight(tmp_path_factory):
    """Return a flight of four bags of a minute."""
    folder = tmp_path_factory.mktemp('flight')
    options = FlightOptions(days=4 / 1440, bag_hours=1 / 60, heads=1, magnitude_limit=5.5,
                            fov_deg=15.0, start_utc_s=1_767_225_600.0)
    for number in range(4):
        write_bag(folder, options, 1, number)
    return folder


@pytest.fixture(scope='module')
def fleet(object_store, flight):
    """Return the URL of the flight."""
    object_store.mkdir('fleet')
    object_store.put(str(flight), 'fleet/', recursive=True)
    return f's3://fleet/{flight.name}'


def command(bags, folder, *options):
    return subprocess.Popen(
        [sys.executable, '-m', 'startracker_ros', 'reprocess', str(bags), '-o', str(folder),
         *OPTIONS, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope='module')
def whole(flight, tmp_path_factory):
    """Return the hashes of the files of a run on this machine."""
    folder = tmp_path_factory.mktemp('local')
    run = command(flight, folder, '--workers', '1')
    assert run.communicate(timeout=HANGS_S) and not run.returncode
    return hashes(folder)


def records(folder: Path) -> int:
    return sum(1 for _ in (folder / '.segments').glob('flight_*/*/*.json'))


def test_a_killed_worker_and_a_restarted_scheduler_change_no_byte(
        fleet, cluster, whole, tmp_path):
    run = command(fleet, tmp_path / 'run', '--scheduler', cluster.address)
    wait_for(lambda: records(tmp_path / 'run') >= 3)
    cluster.workers.pop().kill()
    before = records(tmp_path / 'run')
    wait_for(lambda: records(tmp_path / 'run') >= before + 3)
    cluster.kill()
    before = records(tmp_path / 'run')
    cluster.start()
    out, error = run.communicate(timeout=HANGS_S)
    assert not run.returncode, error
    assert before < records(tmp_path / 'run') == 48
    assert hashes(tmp_path / 'run') == whole
    assert 'errors: none' in out


def test_without_a_scheduler_it_ends_and_goes_on_when_repeated(
        fleet, cluster, whole, tmp_path, monkeypatch):
    monkeypatch.setenv('DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT', '5s')
    run = command(fleet, tmp_path / 'run', '--scheduler', cluster.address)
    wait_for(lambda: records(tmp_path / 'run') >= 3)
    cluster.kill()
    before = records(tmp_path / 'run')
    out, error = run.communicate(timeout=HANGS_S)
    assert run.returncode == 1 and not out.strip()
    assert error.strip() == (f'startracker: the scheduler {cluster.address} was lost and did not '
                             'come back')
    cluster.start()
    run = command(fleet, tmp_path / 'run', '--scheduler', cluster.address, '--json')
    out, error = run.communicate(timeout=HANGS_S)
    assert not run.returncode, error
    assert hashes(tmp_path / 'run') == whole
    assert before <= sum(row['reused'] for row in json.loads(out)['rows']) < 48
