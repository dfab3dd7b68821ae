"""The event camera: the light on its pixels, and what they report while it changes.

A pixel remembers the logarithm of the light at its last event and reports an event each time the
logarithm has changed by its threshold since; the model of Rebecq et al., "ESIM: an Open Event
Camera Simulator" (CoRL 2018), section 3, with sub-frames at given times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix
from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.palette import LUMINANCE
from uncal.simulation.scene.triangle_scene import NOTHING, Scene
from uncal.simulation.sensors.view import View, samples
from uncal.simulation.settings import CameraSettings, EventSettings

Image = NDArray[np.float64]


class LuminanceMeter:
    """Measures one scene's luminance, as the frame camera of the scene would see it.

    With albedo and light per channel c, weights w, and the texture's blend b and grain g,
    Σ_c w_c (a_c + b·d_c) · g · (ambient_c + in_sun · sun_c) is linear in b for the sky and for the
    sun: four numbers per triangle instead of three channels per ray.
    """

    def __init__(self, scene: Scene, settings: CameraSettings, rays: Array) -> None:
        """Work out what all pictures of the scene share.

        ``rays``: (H·n, W·n, 3) float32 directions in the camera frame, z = 1; close to linear in
        row and column, at supersampling n.
        """
        self._scene, self._settings, self._rays = scene, settings, rays
        centre = rays.shape[0] // 2
        self._sample_width = np.abs(np.diff(rays[centre, :, 0])).mean(dtype=np.float32)
        albedo, look, sky = scene.look[:, :3], scene.look, scene.sky
        change = look[:, 3:6]
        weights = [(LUMINANCE * light, share) for light, share in ((sky.ambient, 6), (sky.sun, 7))]
        columns = [part @ w * look[:, share] for w, share in weights for part in (albedo, change)]
        self._light: Array = np.stack(columns, axis=-1).astype(np.float32)
        self._haze = np.float32(LUMINANCE @ sky.horizon)
        self._shadows = settings.shadows and bool(sky.sun.any())

    def measure(self, T_world_cam: Matrix) -> NDArray[np.float32]:
        """Mean luminance of each pixel at a (4, 4) camera pose, (H, W) float32 linear."""
        n, position = self._settings.supersampling, T_world_cam[:3, 3]
        view = View(self._scene, position)
        height, width = self._rays.shape[0] // n, self._rays.shape[1] // n
        light: Array = np.zeros(height * width, np.float32)
        for triangle, rays in samples(self._scene, T_world_cam, self._rays, n):
            light += self._sample(view, position, triangle, rays)
        light /= n * n
        return light.reshape(height, width)

    def _sample(
        self, view: View, position: NDArray[np.float64], triangle: NDArray[np.int32], rays: Array
    ) -> Array:
        """Luminance along (3, N) rays that meet known triangles, (N,)."""
        scene = self._scene
        meeting = view.meet(triangle, rays)
        blend, grain = view.texture_at(meeting, meeting.footprint(self._sample_width))
        row = self._light.take(triangle, axis=0, mode="wrap")
        sun = row[:, 2] + row[:, 3] * blend
        if self._shadows:
            lit = np.flatnonzero((triangle != NOTHING) & (sun > 0))
            points = (rays.take(lit, axis=1) * meeting.t.take(lit)).T + position.astype(np.float32)
            in_sun = np.zeros(len(sun), np.float32)
            in_sun[lit] = scene.in_sun(points, triangle.take(lit))
            sun *= in_sun
        seen = grain * (row[:, 0] + row[:, 1] * blend + sun)
        clear = np.exp(meeting.t * np.float32(-1 / self._settings.haze_m))
        light = self._haze + (seen - self._haze) * clear
        empty = np.flatnonzero(triangle == NOTHING)
        light[empty] = LUMINANCE @ scene.sky.radiance(scene.textures, rays.take(empty, axis=1))
        return np.asarray(light, np.float32)


@dataclass(frozen=True)
class SensorEvents:
    """Events in the sensor's own, unrectified pixels, in the order of time.

    Attributes:
        x: (n,) uint16 column.
        y: (n,) uint16 row.
        t: (n,) int64 microseconds.
        p: (n,) bool, whether the pixel became brighter.
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    t: NDArray[np.int64]
    p: NDArray[np.bool_]

    def __len__(self) -> int:
        """Number of events."""
        return len(self.t)


def merge(parts: Sequence[SensorEvents]) -> SensorEvents:
    """All events of several streams in the order of time."""
    t = np.concatenate([part.t for part in parts])
    order = np.argsort(t, kind="stable")
    x, y = (np.concatenate([getattr(part, axis) for part in parts])[order] for axis in "xy")
    return SensorEvents(x, y, t[order], np.concatenate([part.p for part in parts])[order])


def crossings(
    log_light: NDArray[np.floating],  # (K + 1, H, W) logarithm of the light
    times: NDArray[np.integer],  # (K + 1,) microseconds, ascending
    reference: Image,  # (H, W) what the pixels remember at times[0]
    on: Image,  # (H, W) threshold of getting brighter, > 0
    off: Image,  # (H, W) threshold of getting darker, > 0
    refractory_us: float,  # dead time after an event
) -> SensorEvents:
    """Events of a sequence of images, the logarithm taken as linear in time between two of them.

    Between sub-frames L0 at t0 and L1 at t1, a pixel that remembers R and has the threshold C
    crosses at t = t0 + (R ± j·C - L0) / (L1 - L0) · (t1 - t0), j = 1, 2, … A crossing within the
    refractory period after the pixel's last event is not reported, but remembered (as in ESIM).

    Returns:
        Events with t in [times[0], times[-1]).

    >>> light = np.array([0.0, 1.0]).reshape(2, 1, 1)
    >>> zero, fourth = np.zeros((1, 1)), np.full((1, 1), 0.25)
    >>> crossings(light, np.array([0, 1000]), zero, fourth, fourth, 0.0).t.tolist()
    [250, 500, 750, 999]
    >>> crossings(light, np.array([0, 1000]), zero, fourth, fourth, 300.0).t.tolist()
    [250, 750]
    """
    width = log_light.shape[2]
    light = log_light.reshape(len(log_light), -1).astype(np.float64)
    memory, rise, fall = (each.ravel().astype(np.float64) for each in (reference, on, off))
    last = np.full(memory.shape, -np.inf)
    found_pixel, found_time = [np.empty(0, np.intp)], [np.empty(0)]
    found_sign = [np.empty(0, np.bool_)]
    for before, after, begin, end in zip(light, light[1:], times, times[1:], strict=False):
        since, change = after - memory, after - before
        brighter, darker = (since >= rise) & (change > 0), (since <= -fall) & (change < 0)
        pixel = np.flatnonzero(brighter | darker)
        step = np.where(brighter, rise, -fall)[pixel]
        count = np.floor(since[pixel] / step).astype(int)
        first, slope = memory[pixel] - before[pixel], change[pixel]
        memory[pixel] += count * step
        crossing = np.arange(len(pixel))
        level = 1
        while len(crossing):
            share = (first[crossing] + level * step[crossing]) / slope[crossing]
            moment = begin + share.clip(0, 1) * (end - begin)
            awake = moment >= last[pixel[crossing]] + refractory_us
            fired, moment = pixel[crossing[awake]], moment[awake]
            last[fired] = moment
            found_pixel.append(fired)
            found_time.append(moment)
            found_sign.append(step[crossing[awake]] > 0)
            level += 1
            crossing = crossing[count[crossing] >= level]
    # A crossing on the last moment belongs to the window, which does not hold its own end.
    t = np.minimum(np.concatenate(found_time).astype(np.int64), int(times[-1]) - 1)
    order = np.argsort(t, kind="stable")
    y, x = np.divmod(np.concatenate(found_pixel)[order], width)
    p = np.concatenate(found_sign)[order]
    return SensorEvents(x.astype(np.uint16), y.astype(np.uint16), t[order], p)


def shot_noise(
    rate_hz: float, size: tuple[int, int], begin: int, end: int, rng: np.random.Generator
) -> SensorEvents:
    """Events of no cause: a Poisson process in every pixel, from ``begin`` to ``end`` (µs)."""
    height, width = size
    n = int(rng.poisson(rate_hz * height * width * (end - begin) * 1e-6))
    x = rng.integers(width, size=n, dtype=np.uint16)
    y = rng.integers(height, size=n, dtype=np.uint16)
    t = np.sort(rng.integers(begin, end, n))
    return SensorEvents(x, y, t, rng.random(n) < 0.5)


class EventCamera:
    """A sensor whose pixels differ a little, as they do in silicon.

    Each pixel's thresholds are C·exp(s·n) with n from the standard normal distribution: positive
    for every draw, C in the median, and s their relative spread. They belong to the rig.
    """

    def __init__(
        self, settings: EventSettings, size: tuple[int, int], rng: np.random.Generator
    ) -> None:
        """Draw the pixels of a sensor of (H, W)."""
        self.settings, self.size = settings, size
        spread = np.exp(settings.threshold_mismatch * rng.standard_normal((2, *size)))
        self.on: Image = settings.threshold_on * spread[0]
        self.off: Image = settings.threshold_off * spread[1]

    def watch(
        self,
        luminance: NDArray[np.float32],  # (K + 1, H, W) linear light in any unit
        times: NDArray[np.int64],  # (K + 1,) of these images, microseconds
        rng: np.random.Generator,  # draws the pixels' past and the noise
    ) -> SensorEvents:
        """Report what changes, and noise.

        The pixels have watched before: each stands somewhere between its two thresholds, every
        place as likely as another, so that a change smaller than a threshold is reported with a
        probability that is proportional to it.
        """
        settings = self.settings
        dark = np.float32(settings.dark * luminance[-1].mean(dtype=np.float64))
        log_light = np.log(luminance + dark)
        past = rng.random(self.size) * (self.on + self.off) - self.off
        begin, end = int(times[0]), int(times[-1])
        noise = shot_noise(settings.noise_hz, self.size, begin, end, rng)
        seen = crossings(
            log_light, times, log_light[0] - past, self.on, self.off, settings.refractory_us
        )
        return merge([seen, noise])
