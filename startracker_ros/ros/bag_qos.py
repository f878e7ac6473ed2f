# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quality of service of recorded topics: from publishers to bags, and back to a publisher."""

from collections.abc import Sequence

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from startracker_ros.io.bags.playback import held_messages, MAX_DEPTH
from startracker_ros.io.bags.qos import INFINITE_NS, QosProfile

# DDS does not announce history and depth.
_DEFAULT_DEPTH = 100


def bag_qos(profile: QoSProfile) -> QosProfile:
    """Return the profile of a publisher as a bag stores it."""
    return QosProfile(
        history=profile.history.name.lower(), depth=profile.depth,
        reliability=profile.reliability.name.lower(), durability=profile.durability.name.lower(),
        deadline_ns=profile.deadline.nanoseconds, lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_duration_ns=profile.liveliness_lease_duration.nanoseconds)


def recording_qos(publishers: Sequence[TopicEndpointInfo], depth: int) -> QoSProfile:
    """Return the strictest profile that is compatible with every publisher of a topic."""
    reliable = all(publisher.qos_profile.reliability == ReliabilityPolicy.RELIABLE
                   for publisher in publishers)
    local = all(publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                for publisher in publishers)
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if local else DurabilityPolicy.VOLATILE)


def playback_qos(offers: Sequence[QosProfile]) -> QoSProfile:
    """
    Return a profile compatible with every subscriber that the recorded publishers served.

    It is reliable, which serves subscribers of both kinds: the nodes want images reliable, and
    many cameras are best effort. Deadline, lifespan and lease are those of one publisher: kept if
    all have the same.
    """
    profile = QoSProfile(depth=_DEFAULT_DEPTH)
    if not offers:
        return profile
    known = [offer.depth for offer in offers if offer.history == 'keep_last' and offer.depth]
    # One publisher holds for late subscribers what several have held.
    profile.depth = (min(max(*known, held_messages(offers)), MAX_DEPTH) if known
                     else _DEFAULT_DEPTH)
    if all(offer.history == 'keep_all' for offer in offers):
        profile.history = HistoryPolicy.KEEP_ALL
    if any(offer.durability == 'transient_local' for offer in offers):
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    first = offers[0]
    if all((offer.deadline_ns, offer.lifespan_ns) == (first.deadline_ns, first.lifespan_ns)
           for offer in offers):
        for name, value_ns in (('deadline', first.deadline_ns), ('lifespan', first.lifespan_ns)):
            if 0 < value_ns < INFINITE_NS:
                setattr(profile, name, Duration(nanoseconds=value_ns))
    return profile
