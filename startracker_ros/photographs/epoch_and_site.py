# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""When a photograph was taken, and from where."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.bodies import bodies_from_earth
from startracker_ros.core.astro.earth import EpochError, in_range
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, epoch_year_now
from startracker_ros.core.astro.ground_site import Site
from startracker_ros.core.astro.observer_motion import EARTH_SIGMA_M_S, Observer, observer_at
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.io.images.exif import Taken

OPTION, TODAY = 'option', 'today'
UTC_ASSUMED = ', UTC assumed'


class Epoch(NamedTuple):
    """
    The epoch of a photograph as a Julian year, and its source in words.

    hour_known is False where only the day is known, or nothing.
    """

    year: float
    source: str
    hour_known: bool

    @property
    def known(self) -> bool:
        """Return whether there is a time, of the user or of the image."""
        return self.source != TODAY


def epoch_of(epoch_year: float | None, taken: Taken | None = None) -> Epoch:
    """Return the epoch that the user states, else that of the image, else today."""
    if epoch_year is not None:
        return Epoch(epoch_year, OPTION, True)
    if taken is not None and in_range(year := epoch_year_from_stamp(taken.stamp_ns)):
        return Epoch(year, taken.source + ('' if taken.zone_known else UTC_ASSUMED),
                        taken.zone_known)
    return Epoch(epoch_year_now(), TODAY, False)


@dataclass(frozen=True)
class ObserverSite:
    """A site on the ground, or a velocity (3,) in m/s about the Earth on ICRS axes, or neither."""

    site: Site | None = None
    velocity_m_s: np.ndarray | None = None

    @property
    def known(self) -> bool:
        """Return whether there is a site or a velocity."""
        return self.site is not None or self.velocity_m_s is not None

    def observer(self, when: Epoch) -> Observer:
        """Return how the camera moved; not at all where its time is unknown."""
        if not when.known:
            return Observer(None, EARTH_SIGMA_M_S, 'none', 'no --epoch')
        try:
            if self.site is None:
                return observer_at(when.year, self.velocity_m_s)
            if not when.hour_known:
                # In the hours between two time zones the zenith moves by up to 180 deg.
                return observer_at(when.year, None)._replace(
                    reason='no time zone in EXIF, --epoch is needed for --site')
            return observer_at(when.year, self.site.velocity_m_s(when.year),
                               self.site.air(when.year))
        except EpochError as error:
            return Observer(None, EARTH_SIGMA_M_S, 'none', str(error))

    def bodies(self, when: Epoch) -> Bodies:
        """Return planets, Moon and Sun, none where the hour of the image is unknown."""
        if not (when.hour_known and in_range(when.year)):
            return Bodies()
        return Bodies(bodies_from_earth(
            when.year, None if self.site is None else self.site.position_m(when.year)))
