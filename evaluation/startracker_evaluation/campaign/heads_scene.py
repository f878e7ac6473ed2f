# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Three heads on a body that turns: measured attitudes with the error model of the tracker."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.fusion.fusion import AttitudeFusion, FusedAttitude
from startracker_ros.core.fusion.head import HeadFrame, HeadState
from startracker_ros.core.fusion.mounts import Mount
from startracker_ros.core.maths.rotation import (
    ARCSEC, attitude_error, multiply, quaternion_from_axes, quaternion_from_rotation_vector,
    random_attitude, turned)
from startracker_ros.sim.sky.sensors import Gyro, GyroOptions

START_NS = stamp_from_epoch_year(2026.5)
NAMES = ('head_1', 'head_2', 'head_3')

SIGMA_ARCSEC = np.array([0.9, 0.9, 11.0])
"""Errors of frame_attitude across the boresight and in roll: what `campaign heads` measures of the
tracker at 12 deg, 1024 px and centroids of 0.1 px."""

UNDERSTATED, UNDERSTATED_BY = 'errors 3 times as large as the covariance says', 3.0

WRONG_GYROS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    'axes swapped': lambda rate: rate[[1, 2, 0]], 'a wrong sign': lambda rate: rate * [1, -1, 1],
    'a scale of 1.1': lambda rate: 1.1 * rate,
    'a drift of 0.02 deg/s': lambda rate: rate + np.radians([0.02, 0.0, 0.0])}

# Boresights along z, x and y of the body.
_BORESIGHTS = ((0, 0, 1), (1, 0, 0), (0, 1, 0))


def head_mounts(count: int = 3) -> list[np.ndarray]:
    """Return q_body_from_sensor (4,) of heads whose boresights are 90 deg apart."""
    return [quaternion_from_axes(np.array(z, float), np.roll(np.array(z, float), 1))
            for z in _BORESIGHTS[:count]]


@dataclass(frozen=True)
class Scene:
    """
    How heads, gyro and body behave.

    Heads have frames every period_s, each at another time unless synchronous; they arrive
    delays_s late. turn_deg_s is the size of a steady turn, wobble_deg_s what varies over 100 s,
    acceleration_deg_s2 a white acceleration that lasts for 0.1 s. drop_s is the time for which
    one head after the other is blinded, 0 for none. bend_arcsec is the rms of a misalignment with
    the period of an orbit, temperature_arcsec_k of one with the temperature, step_arcsec that of a
    step of the last head at step_s. fault is what faulty_heads have from fault_s on; wrong_gyro a
    key of WRONG_GYROS, empty for a right one.
    """

    seconds: float
    heads: int = 3
    period_s: float = 0.2
    synchronous: bool = False
    delays_s: tuple[float, ...] = (0.0, 0.0, 0.0)
    gyro: bool = True
    turn_deg_s: float = 0.1
    wobble_deg_s: float = 0.05
    acceleration_deg_s2: float = 0.0
    drop_s: float = 0.0
    orbit_s: float = 5700.0
    bend_arcsec: float = 0.0
    temperature_arcsec_k: float = 0.0
    step_arcsec: float = 0.0
    step_s: float = 0.0
    fault: str = ''
    fault_s: float = 0.0
    faulty_heads: int = 1
    wrong_gyro: str = ''


class Outcome(NamedTuple):
    """A fused attitude next to the truth (4,), and the true misalignments (heads, 3) rad."""

    fused: FusedAttitude
    truth: np.ndarray
    misalignment: np.ndarray


class SceneRun:
    """
    A scene with its random numbers; events() drives a fusion and yields what comes out.

    faulty is the first head with a fault, -1 without one, all_faulty are all of them.
    """

    def __init__(self, scene: Scene, rng: np.random.Generator) -> None:
        self.scene = scene
        self._rng = rng
        self.mounts = head_mounts(scene.heads)
        self.faulty = int(rng.integers(scene.heads)) if scene.fault else -1
        self.all_faulty = [(self.faulty + k) % scene.heads for k in range(
            scene.faulty_heads)] if scene.fault else []
        self.excluded_after: int | None = None
        # A frame of each head in a period; the gyro has a rate in each tick.
        self._ticks = 4 if scene.period_s <= 0.4 else 12
        self._dt_s = scene.period_s / self._ticks
        self._count = round(scene.seconds / self._dt_s)
        # Beyond the end, for a head whose stamps are early.
        self._attitudes, self._rates = self._motion(self._count + 1 + round(1 / self._dt_s))
        self._bend = rng.standard_normal((scene.heads, 2, 3))
        norm = np.linalg.norm(self._bend, axis=(1, 2), keepdims=True)
        # The rms of a cosine and a sine is the root of half their squares.
        self._bend *= scene.bend_arcsec * np.sqrt(2) / norm
        self._slope = rng.standard_normal((scene.heads, 3))
        self._slope *= scene.temperature_arcsec_k / np.linalg.norm(self._slope, axis=1)[:, None]
        self._bend[0], self._slope[0] = 0.0, 0.0
        step = rng.standard_normal(3)
        self.step = scene.step_arcsec * step / np.linalg.norm(step)

    def mount_file(self) -> dict[str, Mount]:
        """Return the mounts as the fusion has them."""
        return {name: Mount(q) for name, q in zip(NAMES, self.mounts)}

    def _motion(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return attitudes (count, 4) of the body and the mean rates (count, 3) before them."""
        scene, rng, dt_s = self.scene, self._rng, self._dt_s
        axes = rng.standard_normal((2, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        time_s = np.arange(count)[:, None] * dt_s
        phase = rng.uniform(0, 2 * np.pi, 3)
        rates = scene.turn_deg_s * axes[0] + scene.wobble_deg_s * axes[1] * np.sin(
            2 * np.pi * time_s / 100 + phase)
        shaken = np.sqrt(0.1 * dt_s) * scene.acceleration_deg_s2 * rng.standard_normal((count, 3))
        rates = np.radians(rates + np.cumsum(shaken, axis=0))
        attitudes = np.empty((count, 4))
        attitudes[0] = random_attitude(rng)
        for k in range(1, count):
            attitudes[k] = turned(attitudes[k - 1], rates[k] * dt_s)
        return attitudes, rates

    def temperature_c(self, time_s: float) -> float:
        """Return a temperature that follows no orbit."""
        return 20 + 8 * np.sin(time_s / 400) + 5 * np.sin(time_s / 977 + 1)

    def misalignment(self, time_s: float) -> np.ndarray:
        """Return the true misalignments (heads, 3) in rad about body axes."""
        phase = 2 * np.pi * time_s / self.scene.orbit_s
        offset = self._bend[:, 0] * np.cos(phase) + self._bend[:, 1] * np.sin(phase)
        offset = offset + self._slope * (self.temperature_c(time_s) - 20)
        if self.scene.step_arcsec and time_s >= self.scene.step_s:
            offset[-1] += self.step
        return offset * ARCSEC

    def _measure(self, head: int, tick: int, time_s: float) -> np.ndarray:
        """Return q_icrf_from_sensor (4,) as a head measures it."""
        faulty = head in self.all_faulty and time_s >= self.scene.fault_s
        offset = self.misalignment(time_s)[head]
        if faulty and self.scene.fault == 'time offset 0.2 s':
            tick += round(0.2 / self._dt_s)
        if faulty and self.scene.fault in ('mount wrong by 1 deg', 'jump of 1 deg'):
            offset = offset + np.radians([0.6, -0.64, 0.48])
        mount = multiply(quaternion_from_rotation_vector(offset), self.mounts[head])
        noise = SIGMA_ARCSEC * ARCSEC * self._rng.standard_normal(3)
        if faulty and self.scene.fault == UNDERSTATED:
            noise *= UNDERSTATED_BY
        return turned(multiply(self._attitudes[tick], mount), noise)

    def _frames(self) -> list[tuple[float, int, int]]:
        """Return arrival in s, tick and head of each frame in order of arrival."""
        scene, frames = self.scene, []
        for tick in range(1, self._count):
            for head in range(scene.heads):
                phase = 0 if scene.synchronous else head * self._ticks // scene.heads
                time_s = tick * self._dt_s
                blind = scene.drop_s and int(time_s / scene.drop_s) % (scene.heads + 1) == head
                if tick % self._ticks == phase and not blind:
                    frames.append((time_s + scene.delays_s[head], tick, head))
        return sorted(frames)

    def inputs(self) -> Iterator[tuple[int, int, HeadFrame | np.ndarray]]:
        """Yield head, tick and frame, or -1, tick and gyro rate (3,), in order of arrival."""
        gyro = Gyro(GyroOptions(), rng=self._rng)
        covariance = np.diag(np.square(SIGMA_ARCSEC * ARCSEC))
        fed = 0
        for arrival_s, tick, head in self._frames():
            while self.scene.gyro and (fed + 1) * self._dt_s <= arrival_s + 1e-9:
                fed += 1
                rate = gyro.measure(self._rates[fed], self._dt_s)
                wrong = self.scene.wrong_gyro
                yield -1, fed, WRONG_GYROS[wrong](rate) if wrong else rate
            yield head, tick, HeadFrame(
                self.stamp_ns(tick), self._measure(head, tick, tick * self._dt_s), covariance)

    def events(self, fusion: AttitudeFusion) -> Iterator[Outcome]:
        """Feed a fusion and yield what it returns, and note when the faulty head is excluded."""
        frames_of_fault = 0
        for head, tick, value in self.inputs():
            time_s = tick * self._dt_s
            if not isinstance(value, HeadFrame):
                fusion.add_rate(self.stamp_ns(tick), value)
                continue
            if self.scene.temperature_arcsec_k:
                fusion.heads[NAMES[head]].set_temperature(self.temperature_c(time_s))
            fused = fusion.add_frame(NAMES[head], value)
            if head == self.faulty and time_s >= self.scene.fault_s:
                frames_of_fault += 1
                if self.excluded_after is None and (
                        fusion.heads[NAMES[head]].state is HeadState.EXCLUDED):
                    self.excluded_after = frames_of_fault
            if fused is not None:
                yield Outcome(fused, self._attitudes[tick], self.misalignment(time_s))

    def stamp_ns(self, tick: int) -> int:
        """Return the stamp of a tick of the gyro."""
        return START_NS + round(tick * self._dt_s * 1e9)


def errors_of(outcomes: list[Outcome]) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (N, 3) rad about body axes and their covariances (N, 3, 3)."""
    return (np.array([attitude_error(one.fused.quaternion, one.truth) for one in outcomes]),
            np.array([one.fused.covariance for one in outcomes]))
