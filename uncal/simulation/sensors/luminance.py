"""Linear luminance of a street along any rays, without colours: fast enough for sub-frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uncal.simulation.rigid import Matrix
from uncal.simulation.scene.meshes import Array
from uncal.simulation.scene.palette import LUMINANCE
from uncal.simulation.scene.triangle_scene import NOTHING, Scene
from uncal.simulation.sensors.view import View
from uncal.simulation.sensors.visibility import samples
from uncal.simulation.settings import CameraSettings


class LuminanceMeter:
    """Measures one scene's luminance, as :class:`~.camera.Camera` would see it.

    With albedo and light per channel c, weights w, and the texture's blend b and grain g,
    Σ_c w_c (a_c + b·d_c) · g · (ambient_c + in_sun · sun_c) is linear in b for the sky and for the
    sun: four numbers per triangle instead of three channels per ray.
    """

    def __init__(self, scene: Scene, settings: CameraSettings, rays: Array) -> None:
        """Work out what all pictures of the scene share.

        Args:
            scene: the street.
            settings: supersampling n, shadows, haze.
            rays: (H·n, W·n, 3) float32 directions in the camera frame, z = 1; close to linear in
                row and column.
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
