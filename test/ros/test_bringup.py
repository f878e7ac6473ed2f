# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Order of the bring-up of managed nodes, and their return after a restart."""

import pytest
from startracker_ros.ros.bringup import Bringup

NAMES = ('estimator', 'tracker', 'extractor')
TIMEOUT_S = 5.0


@pytest.fixture
def bringup():
    return Bringup(NAMES, TIMEOUT_S)


def transitions(bringup, now_s=0.0):
    return {name: wanted for name in NAMES if (wanted := bringup.transition(name, now_s))}


def bring_up(bringup, now_s=0.0):
    """Do what is wanted until nothing is, and return it in order."""
    done = []
    while wanted := transitions(bringup, now_s):
        (name, transition), = wanted.items()
        done.append((name, transition))
        bringup.on_state(name, 'inactive' if transition == 'configure' else 'active', now_s)
    return done


def test_all_are_configured_in_order_then_activated_in_order(bringup):
    assert transitions(bringup) == {}
    assert bringup.problems(0.0) == (False, ', '.join(f'{n} does not respond' for n in NAMES))
    for name in reversed(NAMES):
        bringup.on_state(name, 'unconfigured', 0.0)
    assert bring_up(bringup) == [(name, transition) for transition in ('configure', 'activate')
                                 for name in NAMES]
    assert bringup.problems(0.0) == (False, '')


def test_a_node_that_loads_its_code_for_minutes_is_waited_for(bringup):
    for now_s in range(300):
        bringup.on_state('estimator', 'configuring', now_s)
        for name in NAMES[1:]:
            bringup.on_state(name, 'unconfigured', now_s)
        assert transitions(bringup, now_s) == {}
        assert bringup.problems(now_s) == (False, 'estimator is configuring, tracker is '
                                           'unconfigured, extractor is unconfigured')
    bringup.on_state('estimator', 'inactive', now_s)
    assert bring_up(bringup, now_s)[-1] == ('extractor', 'activate')


def test_later_nodes_wait_for_one_that_is_missing(bringup):
    bringup.on_state('estimator', 'unconfigured', 0.0)
    bringup.on_state('extractor', 'unconfigured', 0.0)
    assert bring_up(bringup) == [('estimator', 'configure')]
    bringup.on_state('tracker', 'unconfigured', 1.0)
    assert bring_up(bringup, 1.0)[-1] == ('extractor', 'activate')


def test_nodes_that_are_active_stay_as_they_are(bringup):
    for name in NAMES:
        bringup.on_state(name, 'active', 0.0)
    assert transitions(bringup) == {} and bringup.problems(0.0) == (False, '')


def test_a_restarted_node_is_brought_up_alone(bringup):
    for name in NAMES:
        bringup.on_state(name, 'active', 0.0)
    now_s = TIMEOUT_S + 1.0
    for name in NAMES[::2]:
        assert not bringup.on_state(name, 'active', now_s)
    assert bringup.problems(now_s) == (True, 'tracker does not respond')
    assert bringup.on_state('tracker', 'unconfigured', now_s)
    assert bring_up(bringup, now_s) == [('tracker', 'configure'), ('tracker', 'activate')]
    # The next one, before anybody has missed it.
    assert bringup.on_state('extractor', 'unconfigured', now_s)
    assert len(bring_up(bringup, now_s)) == 2
    assert not bringup.on_state('extractor', 'active', now_s)


def test_a_node_that_somebody_has_deactivated_stays_inactive(bringup):
    for name in NAMES:
        bringup.on_state(name, 'active', 0.0)
    bringup.on_state('estimator', 'inactive', 1.0)
    bringup.on_state('extractor', 'unconfigured', 1.0)
    assert bring_up(bringup, 1.0) == [('extractor', 'configure'), ('extractor', 'activate')]
    assert bringup.problems(1.0) == (False, 'estimator is inactive')
    # Its process has ended meanwhile.
    assert bringup.on_state('estimator', 'unconfigured', 2.0)
    assert bring_up(bringup, 2.0)[-1] == ('estimator', 'activate')


def test_a_rejected_transition_is_requested_again_after_the_timeout(bringup):
    bringup.on_state('estimator', 'unconfigured', 0.0)
    bringup.on_failure('estimator', 'configure', 0.0)
    for now_s in (0.0, TIMEOUT_S - 0.1):
        bringup.on_state('estimator', 'unconfigured', now_s)
        assert transitions(bringup, now_s) == {}
    serious, problems = bringup.problems(0.0)
    assert serious and problems.startswith('estimator rejects configure, see its log')
    bringup.on_state('estimator', 'unconfigured', TIMEOUT_S)
    assert transitions(bringup, TIMEOUT_S) == {'estimator': 'configure'}


def test_a_finalized_node_needs_somebody(bringup):
    for name in NAMES:
        bringup.on_state(name, 'active', 0.0)
    bringup.on_state('tracker', 'finalized', 0.0)
    assert transitions(bringup) == {} and bringup.problems(0.0) == (True, 'tracker is finalized')


@pytest.mark.parametrize('names', [('a', 'a'), ('a', '')])
def test_names_that_cannot_be(names):
    with pytest.raises(ValueError, match='node_names'):
        Bringup(names, 1.0)
