"""Quality of service as rosbag2 notes it, free of ROS."""

from dataclasses import asdict, dataclass
from typing import Any

INFINITE_NS = 2 ** 63 - 1

# The names of rmw/qos_string_conversions; ros2 bag play refuses others.
_POLICIES = {
    'history': ('system_default', 'keep_last', 'keep_all', 'unknown'),
    'reliability': ('system_default', 'reliable', 'best_effort', 'best_available', 'unknown'),
    'durability': ('system_default', 'transient_local', 'volatile', 'best_available', 'unknown'),
    'liveliness': ('system_default', 'automatic', 'manual_by_topic', 'best_available', 'unknown'),
}


@dataclass(frozen=True)
class QosProfile:
    """What one publisher offers; the defaults are those of a plain publisher seen over DDS.

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
                                 f'{", ".join(names)}')

    def as_dict(self) -> dict[str, Any]:
        """Return the mapping of a bag's metadata, version 9, in its order."""
        return dict(_entry(name, value) for name, value in asdict(self).items())


def _entry(name: str, value: Any) -> tuple[str, Any]:
    if not name.endswith('_ns'):
        return name, value
    seconds, nanoseconds = divmod(value, 10 ** 9)
    return name.removesuffix('_ns'), {'sec': seconds, 'nsec': nanoseconds}
