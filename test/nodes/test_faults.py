"""Every fault of the matrix, shorter than the campaign has it, on one running pipeline."""

import pytest
from startracker_ros.ros.faults import faults, row_of, Times
from startracker_ros.ros.flight import Flight
from startracker_ros.ros.processes import share_folder

# The lease of a participant is 20 s by default; here the nodes count each other gone after 4 s.
TIMES = Times(blind_s=6.0, lease_s=6.0, dead_s=2.0, frames_s=2.0, orders=1)


@pytest.fixture(scope='module')
def flight(tmp_path_factory):
    """Return a pipeline of real processes and its sky."""
    folder = tmp_path_factory.mktemp('flight')
    profile = (share_folder() / 'config' / 'fastdds.xml').read_text().replace(
        '<leaseAnnouncement>', '<leaseDuration><sec>4</sec></leaseDuration><leaseAnnouncement>')
    (folder / 'fastdds.xml').write_text(profile)
    environment = {'FASTRTPS_DEFAULT_PROFILES_FILE': str(folder / 'fastdds.xml')}
    with Flight(folder, seed=2, environment=environment) as flight:
        yield flight


@pytest.mark.parametrize('name', faults(TIMES))
def test_the_nodes_recover_from(flight, name):
    row = row_of(flight, name, TIMES)
    assert row['recovery_s'] is not None and row['recovery_s'] < 30, row
    assert row['wrong'] == 0 and row['attitudes'] > 0, row
    # Later than in the campaign may be, on a machine that runs other tests beside.
    assert row['holds'] or row['recovery_s'] > row['bound_s'], row
