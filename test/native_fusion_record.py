# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Write test/native/fusion.npz: what the fusion in Python is given in scenes, and what it gives.

Of a scene: options, mounts (N, 4), events (E, 3) of kind (0 rate, 1 frame, 2 temperature), head
and stamp, numbers of these; of each frame valid (F,), state (F, N) and codes (F, 2 + N); of one in
EACH fused (G, 37); counts (N, 6) at the end and steps (S, 8).
"""

from dataclasses import asdict

from native_fusion import RECORD, STATES
import numpy as np
from startracker_evaluation.campaign.heads_scene import Scene, SceneRun
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.fusion.fusion import AttitudeFusion
from startracker_ros.core.fusion.mounts import MountOptions
from startracker_ros.core.fusion.options import FusionOptions

EACH, MOST = 7, 400
COUNTS = ('used', 'repeated stamps', 'late', 'ahead', 'disagreeing', 'agreeing, not counted yet')
KNOWN = MountOptions(mount_sigma_arcsec=0.0, mount_walk_arcsec_sqrt_h=0.0)
LEARNT = MountOptions(mount_sigma_arcsec=3.0)
BENT = MountOptions(mount_sigma_arcsec=3.0, mount_orbit_arcsec=20.0, orbit_period_s=600.0,
                    mount_temperature_arcsec_k=1.0)
ALONE = FusionOptions(correlation_s=0.3)
SCENES = {
    'late': (Scene(20.0, drop_s=4.0, delays_s=(0.0, 0.12, 0.03)), KNOWN, FusionOptions()),
    'no_gyro': (Scene(20.0, gyro=False, wobble_deg_s=2.0, heads=2), LEARNT, FusionOptions()),
    'law': (Scene(60.0, period_s=1.0, orbit_s=600.0, bend_arcsec=20.0, temperature_arcsec_k=1.0),
            BENT, FusionOptions()),
    'jump': (Scene(24.0, fault='jump of 1 deg', fault_s=12.0), LEARNT, FusionOptions()),
    'mount': (Scene(12.0, fault='mount wrong by 1 deg'), LEARNT, FusionOptions()),
    'stamps': (Scene(16.0, fault='time offset 0.2 s', fault_s=6.0, turn_deg_s=0.3), LEARNT,
               FusionOptions()),
    'one_head': (Scene(16.0, heads=1), KNOWN, ALONE),
    'noise': (Scene(24.0, fault='errors 3 times as large as the covariance says'), LEARNT,
              FusionOptions()),
    'noise_of_two': (Scene(130.0, fault='errors 3 times as large as the covariance says',
                           faulty_heads=2), KNOWN, FusionOptions()),
    'gyro_axes': (Scene(12.0, turn_deg_s=0.3, wrong_gyro='axes swapped'), KNOWN, FusionOptions()),
    'gyro_scale': (Scene(24.0, turn_deg_s=0.3, wobble_deg_s=0.5, wrong_gyro='a scale of 1.1'),
                   KNOWN, FusionOptions())}

CODES = (  # by words of the texts
    ('waiting for frames', 700), ('no frames of two', 701), ('disagree by', 702),
    ('no head that another', 703), ('no other head counts', 704), ('not positive definite', 705),
    ('mounts_file', 706), ('no frames yet', 720), ('repeats stamps', 721),
    ('behind the other', 722),
    ('ahead of imu', 724), ('ahead of the other', 723), ('no other head or prediction', 725),
    ('after a time without', 726), ('deg from', 727), ('behind the heads', 740),
    ('does not turn so', 741), ('the heads agree', 743), ('imu reports', 742))


def code_of(text: str) -> int:
    return next((code for words, code in CODES if words in text), -1) if text else 0


class Recorded(AttitudeFusion):
    """A fusion that records what it is given and what it gives."""

    def start(self) -> None:
        self.events, self.numbers, self.valid, self.states = [], [], [], []
        self.codes, self.fused, self.found = [], [], []
        for number, head in enumerate(self.heads.values()):
            head.set_temperature = self._temperature(number, head.set_temperature)

    def _temperature(self, number, original):
        def set_temperature(celsius):
            self.events.append((2, number, 0))
            self.numbers.append([celsius])
            return original(celsius)
        return set_temperature

    def add_rate(self, stamp_ns, rate_rad_s):
        self.events.append((0, 0, stamp_ns))
        self.numbers.append(rate_rad_s)
        return super().add_rate(stamp_ns, rate_rad_s)

    def add_frame(self, name, frame):
        self.events.append((1, list(self.heads).index(name), frame.stamp_ns))
        self.numbers.append(np.r_[frame.quaternion, frame.covariance.ravel()])
        result = super().add_frame(name, frame)
        self.valid.append(result is not None)
        self.states.append([STATES.index(head.state) for head in self.heads.values()])
        self.codes.append([code_of(text) for text in (
            self.trouble, self.motion.gyro_trouble,
            *(head.reason for head in self.heads.values()))])
        for step in self.steps:
            self.found.append(np.r_[list(self.heads).index(step.head), step.stamp_ns,
                                    step.size_rad, step.sigma_rad])
        self.steps.clear()
        if result is not None and len(self.valid) % EACH == 0:
            self.fused.append(np.concatenate([np.ravel(one) for one in (
                result.quaternion, result.covariance, result.rate_rad_s, result.rate_covariance,
                result.drift_rad_s, result.drift_covariance)]))
        return result


def main() -> None:
    saved = {}
    for name, (scene, mount_options, options) in SCENES.items():
        run = SceneRun(scene, np.random.default_rng(2 if name == 'noise_of_two' else 1))
        fusion = Recorded(run.mount_file(), options, mount_options)
        fusion.start()
        for _ in run.events(fusion):
            if len(fusion.valid) > MOST:
                break
        assert not (np.array(fusion.codes) < 0).any()
        everything = {**asdict(options), **asdict(mount_options), **asdict(GyroErrorOptions())}
        saved |= {f'{name} {key}': value for key, value in {
            'options': list(everything.values()), 'mounts': run.mounts, 'events': fusion.events,
            'numbers': np.concatenate([np.ravel(one) for one in fusion.numbers]),
            'valid': fusion.valid, 'states': np.array(fusion.states, np.int8),
            'codes': np.array(fusion.codes, np.int16), 'fused': fusion.fused,
            'counts': [[head.counts[one] for one in COUNTS] for head in fusion.heads.values()],
            'steps': fusion.found}.items()}
        print(name, len(fusion.valid), len(fusion.fused))
    np.savez_compressed(RECORD, **saved)
    print(RECORD, RECORD.stat().st_size // 1000, 'kB', list(everything))


if __name__ == '__main__':
    main()
