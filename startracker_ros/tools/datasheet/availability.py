# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Availability of the attitude under glare, with bright bodies in the field, under protons."""

from dataclasses import replace
from typing import Any, NamedTuple

from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.tools.datasheet.image_runs import image_run, ImageCondition
from startracker_ros.tools.datasheet.instrument import Instrument
from startracker_ros.tools.datasheet.tally import Tally

STRAY_LIGHT_E = (500.0, 2000.0, 5000.0, 10_000.0)
PROTONS_CM2_S = (5.0, 1000.0, 10_000.0, 100_000.0)

_CLEAN_FRAMES = 10


class Disturbance(NamedTuple):
    """A name, and the options of detector and artefacts that differ from the clean ones."""

    name: str
    detector: dict[str, Any]
    artefacts: ArtefactOptions = ArtefactOptions()


DISTURBANCES = (
    *(Disturbance(f'glare of Sun, Moon or Earth, {level:g} e- at the edge of the image',
                  {'stray_light_e': level}) for level in STRAY_LIGHT_E),
    Disturbance('full Moon in the field, 2 deg off the boresight', {'blooming': True},
                ArtefactOptions(moon_e=40_000.0, moon_distance_deg=2.0)),
    Disturbance('limb of the bright Earth in the field, 4 deg off the boresight', {},
                ArtefactOptions(earth_e=20_000.0)),
    *(Disturbance(f'protons, {flux:g} hits/cm^2/s', {'cosmic_ray_hits_cm2_s': flux})
      for flux in PROTONS_CM2_S))


def disturbed_runs(instrument: Instrument, disturbance: Disturbance, frames: int, runs: int,
                   seed: int) -> Tally:
    """Return the tally of so many runs that begin undisturbed."""
    detector: DetectorOptions = replace(instrument.detector, **disturbance.detector)
    condition = ImageCondition(
        detector=detector, artefacts=disturbance.artefacts, clean_frames=_CLEAN_FRAMES,
        frames=_CLEAN_FRAMES + frames, clean_detector=instrument.detector)
    return sum((image_run(condition, seed + run, instrument.lens) for run in range(runs)), Tally())
