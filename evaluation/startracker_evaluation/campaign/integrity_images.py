# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Is a published attitude ever wrong? Images with the artefacts of real sensors."""

from typing import Any

from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.from_options import with_preset
from startracker_ros.tools.datasheet.image_runs import image_run, ImageCondition
from startracker_ros.tools.datasheet.tally import CAMERA, Tally

START_FRAMES = 10
"""Frames within which a start has to succeed."""

CLEAN_FRAMES = 10
_LINE_TIME_US = 20.0
_CM2 = (CAMERA.width * 5.5e-4) ** 2


def _smear(rate_deg_s: float, exposure_s: float = 0.1, needed_percent: float = 99.0,
           gyro: bool = False) -> ImageCondition:
    return ImageCondition(
        rate_deg_s, detector=DetectorOptions(motion_smear=True, exposure_s=exposure_s),
        gyro=gyro, needed_percent=needed_percent)


def _rolling(rate_deg_s: float, line_time_us: float, needed_percent: float) -> ImageCondition:
    return ImageCondition(rate_deg_s, detector=DetectorOptions(line_time_us=_LINE_TIME_US),
                          line_time_us=line_time_us, needed_percent=needed_percent)


def _shaken(needed_percent: float, vibration_arcsec: float = 0.0, kick_arcsec: float = 0.0
            ) -> ImageCondition:
    return ImageCondition(
        vibration_arcsec=vibration_arcsec, kick_arcsec=kick_arcsec,
        detector=DetectorOptions(motion_smear=True), needed_percent=needed_percent)


def _sway(sway_deg: float, sway_s: float, exposure_s: float = 0.1, line_time_us: float = 0.0
          ) -> ImageCondition:
    return ImageCondition(
        0.02, sway_deg=sway_deg, sway_s=sway_s, line_time_us=line_time_us,
        detector=DetectorOptions(
            motion_smear=True, exposure_s=exposure_s, line_time_us=line_time_us))


def _torn(rate_deg_s: float) -> ImageCondition:
    return ImageCondition(rate_deg_s, artefacts=ArtefactOptions(torn_frame_probability=0.5),
                          needed_percent=0.0)


def _hits(number: float) -> ImageCondition:
    """Return the condition of this mean number of cosmic-ray hits in each image of 0.1 s."""
    return ImageCondition(detector=DetectorOptions(cosmic_ray_hits_cm2_s=number / _CM2 / 0.1),
                          clean_frames=CLEAN_FRAMES)


def _spots(number: int) -> ImageCondition:
    return ImageCondition(artefacts=ArtefactOptions(star_like_spots=number),
                          clean_frames=CLEAN_FRAMES)


def _debris(number: int, sigma_px: float, needed_percent: float = 95.0, **when: Any
            ) -> ImageCondition:
    return ImageCondition(artefacts=ArtefactOptions(debris=number, debris_sigma_px=sigma_px),
                          needed_percent=needed_percent, **when)


def _trails(number: int) -> ImageCondition:
    return ImageCondition(artefacts=ArtefactOptions(trails=number))


IMAGE_CONDITIONS = {
    'clean images': ImageCondition(),
    'smear 0.3 deg/s': _smear(0.3),
    'smear 1 deg/s': _smear(1.0),
    'smear 2 deg/s': _smear(2.0),
    'smear 3 deg/s': _smear(3.0),
    'smear 5 deg/s, 20 ms': _smear(5.0, 0.02, 95.0),
    'smear 10 deg/s, 20 ms': _smear(10.0, 0.02, 95.0),
    'smear 5 deg/s, gyro': _smear(5.0, needed_percent=95.0, gyro=True),
    'rolling shutter 0.1 deg/s': _rolling(0.1, _LINE_TIME_US, 99.0),
    'rolling shutter 1 deg/s': _rolling(1.0, _LINE_TIME_US, 99.0),
    'rolling shutter 0.1 deg/s, line time 0': _rolling(0.1, 0.0, 0.0),
    'rolling shutter 1 deg/s, line time 0': _rolling(1.0, 0.0, 0.0),
    'torn frames 0.14 deg/s': _torn(0.14),
    'torn frames 1 deg/s': _torn(1.0),
    '1 trail': _trails(1),
    '3 trails': _trails(3),
    '20 trails': _trails(20),
    '5 saturated columns and rows': ImageCondition(
        artefacts=ArtefactOptions(saturated_columns=5, saturated_rows=5)),
    '300 hits': _hits(300),
    '1000 hits': _hits(1000),
    '10000 hits': _hits(10_000),
    '50 spots': _spots(50),
    '100 spots': _spots(100),
    '300 spots': _spots(300),
    'start with 100 spots': ImageCondition(
        artefacts=ArtefactOptions(star_like_spots=100), start=True, frames=START_FRAMES,
        needed_percent=95.0),
    'debris, 150 of 3 px': _debris(150, 3.0, clean_frames=CLEAN_FRAMES),
    'debris, 300 points': _debris(300, 0.8, clean_frames=CLEAN_FRAMES),
    'start with debris, 150 of 3 px': _debris(150, 3.0, 90.0, start=True,
                                              frames=2 * START_FRAMES),
    'Moon in the field': ImageCondition(
        detector=DetectorOptions(blooming=True),
        artefacts=ArtefactOptions(moon_e=40_000.0, moon_distance_deg=2.0)),
    'Earth limb': ImageCondition(artefacts=ArtefactOptions(earth_e=20_000.0),
                                 needed_percent=95.0),
    'ghosts': ImageCondition(artefacts=ArtefactOptions(ghost_ratio=0.02)),
    'double exposure': ImageCondition(artefacts=ArtefactOptions(double_exposure_share=0.3),
                                      needed_percent=95.0),
    'stamp at the end': ImageCondition(0.5, artefacts=ArtefactOptions(stamp='end'),
                                       needed_percent=0.0, detectable=False),
    'defocus': ImageCondition(detector=DetectorOptions(psf_sigma_px=2.5), needed_percent=95.0),
    'defocus, ring of 3 px': ImageCondition(
        detector=DetectorOptions(defocus_ring_px=3.0), needed_percent=95.0),
    'stamps that err by 5 ms': ImageCondition(
        0.3, artefacts=ArtefactOptions(stamp_jitter_ms=5.0), needed_percent=95.0),
    'stray light': ImageCondition(
        detector=DetectorOptions(stray_light_e=8_000.0), needed_percent=95.0),
    'coma': ImageCondition(detector=DetectorOptions(coma_corner_px=3.0), needed_percent=95.0),
    'repeated frames': ImageCondition(
        0.5, artefacts=ArtefactOptions(repeated_frame_probability=0.1), needed_percent=80.0),
    'repeated frames 0.002 deg/s': ImageCondition(
        0.002, artefacts=ArtefactOptions(repeated_frame_probability=0.3), needed_percent=60.0,
        clean_frames=CLEAN_FRAMES),
    'preset harsh': ImageCondition(
        detector=with_preset(DetectorOptions(), 'harsh'),
        artefacts=with_preset(ArtefactOptions(), 'harsh'),
        line_time_us=10.0, needed_percent=90.0),
    'vibration 10 arcsec': _shaken(99.0, vibration_arcsec=10.0),
    'vibration 40 arcsec': _shaken(95.0, vibration_arcsec=40.0),
    'vibration 100 arcsec': _shaken(0.0, vibration_arcsec=100.0),
    'kicks of 40 arcsec': _shaken(95.0, kick_arcsec=40.0),
    'kicks of 120 arcsec': _shaken(50.0, kick_arcsec=120.0),
    'kicks of 250 arcsec': _shaken(50.0, kick_arcsec=250.0),
    'sway 1 deg, 10 s': _sway(1.0, 10.0),
    'sway 0.2 deg, 2 s': _sway(0.2, 2.0),
    'sway 0.05 deg, 1 s': _sway(0.05, 1.0),
    'sway 0.05 deg, 1 s, exposed 10 ms': _sway(0.05, 1.0, 0.01),
    'sway 0.01 deg, 0.5 s': _sway(0.01, 0.5),
    'sway 5 deg, 30 s': _sway(5.0, 30.0),
    'sway 0.2 deg, 2 s, exposed 20 ms, rolling shutter': _sway(0.2, 2.0, 0.02, 80.0),
    'sway 0.05 deg, 1 s, exposed 20 ms, rolling shutter': _sway(0.05, 1.0, 0.02, 80.0),
}


def image_runs(name: str, runs: int, seed: int) -> Tally:
    """Return the tally of so many runs of a condition, with the seeds from seed on."""
    return sum((image_run(IMAGE_CONDITIONS[name], seed + run) for run in range(runs)), Tally())
