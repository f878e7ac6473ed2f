"""Options of a simulated scene."""

from dataclasses import dataclass

from startracker_ros.catalog.deep import DEEP_LIMIT
from startracker_ros.options import option, Options
from startracker_ros.sky.presets import PRESETS


@dataclass(frozen=True)
class SceneOptions(Options):
    """Which sky is simulated, and how many pixels see it."""

    width: int = option(1024, 'image width; a camera_file brings its own', unit='px',
                        low=16, high=4096)
    height: int = option(1024, 'image height; a camera_file brings its own', unit='px',
                         low=16, high=4096)
    faint_limit: float = option(
        9.0, 'faintest star that is drawn, V; beyond 9 only fields below 4 deg have stars',
        unit='mag', low=0.0, high=DEEP_LIMIT)
    seed: int = option(1, 'seed of all noise: the same seed gives the same images',
                       low=0, high=2 ** 31 - 1)
    preset: str = option(
        'none', 'harsh: a bad day of a worn sensor; its values replace those of the parameters '
        'that are at their defaults', choices=tuple(PRESETS))
