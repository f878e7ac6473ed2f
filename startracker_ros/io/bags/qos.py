# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Quality of service as rosbag2 writes it, without rclpy."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from startracker_ros.core.yaml_text import load_yaml

INFINITE_NS = 2 ** 63 - 1

# The names of rmw/qos_string_conversions, at the numbers of rmw/types.h that stood for them before
# version 9 of the metadata; ros2 bag play rejects others.
_POLICIES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'unknown', 'best_available'),
    'durability': ('system_default', 'transient_local', 'volatile', 'unknown', 'best_available'),
    'liveliness': ('system_default', 'automatic', 'unknown', 'manual_by_topic', 'unknown',
                   'best_available'),
}


@dataclass(frozen=True)
class QosProfile:
    """
    What one publisher offers; the defaults are those of a default publisher seen over DDS.

    History and depth do not travel over DDS: a recorder sees 'unknown' and 0.
    """

    history: str = 'unknown'
    depth: int = 0
    reliability: str = 'reliable'
    durability: str = 'volatile'
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = 'automatic'
    liveliness_lease_duration_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    def __post_init__(self) -> None:
        for policy, names in _POLICIES.items():
            if getattr(self, policy) not in names:
                raise ValueError(f'{policy} = {getattr(self, policy)!r} must be one of '
                                 f'{", ".join(dict.fromkeys(names))}')

    def as_dict(self) -> dict[str, Any]:
        """Return the mapping of a bag's metadata, version 9, in its order."""
        return dict(_entry(name, value) for name, value in asdict(self).items())

    @classmethod
    def from_dict(cls, entries: Mapping[str, Any]) -> 'QosProfile':
        """
        Return the profile of a mapping of any version; ValueError for anything else.

        Missing entries keep their defaults.
        """
        values: dict[str, Any] = {}
        for field in fields(cls):
            value = entries.get(field.name.removesuffix('_ns'))
            if value is None:
                continue
            if field.name.endswith('_ns'):
                values[field.name] = _duration_ns(field.name, value)
            elif field.name in _POLICIES and type(value) is int:
                names = _POLICIES[field.name]
                values[field.name] = names[value] if 0 <= value < len(names) else 'unknown'
            elif type(value) is type(field.default):
                values[field.name] = value
            else:
                raise ValueError(f'{field.name} = {value!r} is not of a quality of service')
        return cls(**values)


def qos_from_yaml(text: str) -> tuple[QosProfile, ...]:
    """Return the profiles of a channel's offered_qos_profiles; ValueError for anything else."""
    entries = load_yaml(text)
    if not isinstance(entries or [], list) or not all(
            isinstance(entry, Mapping) for entry in entries or []):
        raise ValueError(f'{text[:60]!r} is not a list of profiles')
    return tuple(QosProfile.from_dict(entry) for entry in entries or [])


def _duration_ns(name: str, value: Any) -> int:
    parts = [value.get(part, 0) for part in ('sec', 'nsec')] if isinstance(value, Mapping) else []
    if not parts or not all(type(part) is int for part in parts):
        raise ValueError(f'{name} = {value!r} is not a duration')
    return min(max(parts[0] * 10 ** 9 + parts[1], 0), INFINITE_NS)


def _entry(name: str, value: Any) -> tuple[str, Any]:
    if not name.endswith('_ns'):
        return name, value
    seconds, nanoseconds = divmod(value, 10 ** 9)
    return name.removesuffix('_ns'), {'sec': seconds, 'nsec': nanoseconds}
