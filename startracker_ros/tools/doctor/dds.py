# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The settings of DDS, and an image sent from one process to another."""

from collections.abc import Iterator, Mapping
import json
import os
from pathlib import Path
import shutil
import subprocess
import sys
from xml.etree import ElementTree

from startracker_ros.ros.memory import profile_variable, PROFILE_VARIABLES
from startracker_ros.ros.processes import node_environment
from startracker_ros.tools.doctor.install import Check

_RANGES = ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT')
# Ports of higher domains are those that Linux gives to others.
_LAST_DOMAIN = 101
_LARGEST_IMAGE_BYTES = 2048 * 2048 * 2
_NODES = 6
_SHARED_MEMORY = Path('/dev/shm')


def check_dds() -> Iterator[Check]:
    """Yield the checks of the transport between nodes."""
    environment = node_environment()
    yield check_middleware(environment)
    yield check_domain(environment)
    yield check_discovery(environment)
    yield check_profile(environment, own=any(name in os.environ for name in PROFILE_VARIABLES))
    yield check_security(environment)
    if _SHARED_MEMORY.is_dir():
        yield check_shared_memory(shutil.disk_usage(_SHARED_MEMORY).free)
    yield check_loopback(environment)


def check_middleware(environment: Mapping[str, str]) -> Check:
    """Return which middleware is used."""
    name = environment.get('RMW_IMPLEMENTATION', '')
    known = name in ('', 'rmw_fastrtps_cpp')
    return Check('middleware', name or 'rmw_fastrtps_cpp (default)', True,
                 '' if known else 'unset RMW_IMPLEMENTATION: the profile and all figures are '
                 'for rmw_fastrtps_cpp')


def check_domain(environment: Mapping[str, str]) -> Check:
    """Return whether ROS_DOMAIN_ID is one that works."""
    text = environment.get('ROS_DOMAIN_ID') or '0'
    holds = text.isascii() and text.isdigit() and int(text) <= _LAST_DOMAIN
    return Check('ROS_DOMAIN_ID', text, holds,
                 '' if holds else f'set it to a number from 0 to {_LAST_DOMAIN}, '
                 'the same for all nodes')


def check_discovery(environment: Mapping[str, str]) -> Check:
    """Return how far nodes look for each other."""
    text = environment.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'SUBNET'
    if environment.get('ROS_LOCALHOST_ONLY') == '1':
        return Check('discovery range', 'ROS_LOCALHOST_ONLY=1, which hides the others', True,
                     'unset it and set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST')
    if text not in _RANGES:
        return Check('discovery range', f'{text}, which is not a range', False,
                     f'set ROS_AUTOMATIC_DISCOVERY_RANGE to one of {", ".join(_RANGES)}')
    if text == 'OFF':
        return Check('discovery range', 'OFF: no node finds another', False,
                     'set ROS_AUTOMATIC_DISCOVERY_RANGE to LOCALHOST or SUBNET')
    return Check('discovery range', text, True, '' if text == 'LOCALHOST' else
                 'anyone in the network can speak to the nodes: '
                 'ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, or docs/security.md')


def check_profile(environment: Mapping[str, str], *, own: bool) -> Check:
    """Return whether the profile of Fast DDS has room for images; own: plain ros2 run has it."""
    path = next(environment[name] for name in PROFILE_VARIABLES if name in environment)
    remedy = (f'unset {" and ".join(PROFILE_VARIABLES)}, or set it to config/fastdds.xml of the '
            'package')
    try:
        root = ElementTree.parse(path).getroot()
        sizes = [int(node.text or '') for node in root.iter()
                 if node.tag.rpartition('}')[2] == 'segment_size']
    except (OSError, ElementTree.ParseError, ValueError) as error:
        return Check('Fast DDS profile', f'{path}: {error}', False, remedy)
    if max(sizes, default=0) < 2 * _LARGEST_IMAGE_BYTES:
        return Check('Fast DDS profile', f'{path}: shared memory too small for images', False,
                     remedy)
    return Check('Fast DDS profile', path, True,
                 '' if own else f'for plain ros2 run: export {profile_variable()}={path}')


def check_security(environment: Mapping[str, str]) -> Check:
    """Return whether security is on, and its keys are there."""
    if environment.get('ROS_SECURITY_ENABLE', '').lower() != 'true':
        return Check('security', 'off: messages are neither signed nor encrypted', True,
                     'in a network of others: docs/security.md')
    keystore = environment.get('ROS_SECURITY_KEYSTORE', '')
    holds = bool(keystore) and Path(keystore, 'enclaves').is_dir()
    enforced = environment.get('ROS_SECURITY_STRATEGY') == 'Enforce'
    return Check('security', f'on, keys in {keystore or "no folder"}', holds,
                 'set ROS_SECURITY_KEYSTORE to what ros2 security create_keystore made'
                 if not holds else '' if enforced else
                 'ROS_SECURITY_STRATEGY=Enforce: without it a node without keys starts unsecured')


def check_shared_memory(free_bytes: int) -> Check:
    """Return whether every node finds room for its segment."""
    needed = _NODES * 64 * 2 ** 20
    holds = free_bytes >= needed
    return Check('shared memory', f'{free_bytes / 2 ** 20:.0f} MiB free, {_NODES} nodes take '
                                  f'{needed / 2 ** 20:.0f}', holds,
                 '' if holds else 'docker run --shm-size=1g, or a larger /dev/shm: '
                 'images go over UDP until then, slower')


def check_loopback(environment: Mapping[str, str], timeout_s: float = 30.0) -> Check:
    """Return whether an image of 2 MiB comes from another process, and how soon."""
    command = [sys.executable, '-m', 'startracker_ros.tools.doctor.processes']
    topic = f'startracker_doctor_{os.getpid()}'
    sender = subprocess.Popen([*command, 'send', topic], env=dict(environment),
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        done = subprocess.run([*command, 'receive', topic], env=dict(environment), text=True,
                              capture_output=True, timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return Check('loopback', f'no image from another process in {timeout_s:.0f} s', False,
                     'compare the rows above with those of the other machine or container; '
                     'a firewall must let UDP 7400 and up pass')
    finally:
        sender.kill()
        sender.wait()
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or [f'status {done.returncode}']
        return Check('loopback', lines[-1], False, 'see docs/troubleshooting.md')
    return Check('loopback', f'2 MiB image in {json.loads(done.stdout)["median_ms"]:.1f} ms')
