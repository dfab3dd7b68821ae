from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from uncal.errors import ConfigurationError
from uncal.simulation.sensors.event_optics import EventOptics, draw_optics
from uncal.simulation.sensors.rig import Rig, draw_rig
from uncal.simulation.settings import SimulationSettings

MakeSettings = Callable[..., SimulationSettings]
SIZE = (24, 64)


def drawn(settings: SimulationSettings, index: int = 1) -> tuple[Rig, EventOptics]:
    rig = draw_rig(settings, index)
    return rig, draw_optics(settings, index, rig)


def seen_by_sensor(optics: EventOptics, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where OpenCV's model of the lens puts rectified pixels on the sensor."""
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(optics.K_rect).T
    turn = cv2.Rodrigues(optics.R_rect[0].T)[0]
    lens = np.array(optics.distortion)
    seen = cv2.projectPoints(rays, turn, np.zeros(3), optics.K, lens)[0]
    return np.asarray(seen, np.float64).reshape(-1, 2)


@pytest.mark.parametrize("distortion", [-0.1, 0.2])
def test_the_map_undoes_opencvs_lens_and_rotation(
    make_event_settings: MakeSettings, distortion: float
) -> None:
    _, optics = drawn(make_event_settings(events={"distortion": distortion}))
    rectify_map = optics.rectify_map(SIZE)
    assert rectify_map.shape == (*SIZE, 2)
    assert rectify_map.dtype == np.float32
    back = seen_by_sensor(optics, rectify_map.reshape(-1, 2).astype(np.float64))
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    np.testing.assert_allclose(back, np.stack([x, y], -1).reshape(-1, 2), atol=1e-4)


def test_the_map_is_not_the_identity(make_event_settings: MakeSettings) -> None:
    settings = make_event_settings(camera={"height": 80, "width": 208, "focal_px": 230.0})
    _, optics = drawn(settings)
    y, x = np.mgrid[:80, :208]
    shift = optics.rectify_map((80, 208)) - np.stack([x, y], -1)
    away = np.hypot(*np.moveaxis(shift, -1, 0))
    assert away.max() > 2
    assert away.max() < 12
    # Not a mere shift either: the corners move apart.
    assert np.ptp(shift[..., 0]) > 1


def test_rays_point_where_the_map_says(make_event_settings: MakeSettings) -> None:
    _, optics = drawn(make_event_settings())
    rays = optics.rays(SIZE, 1)
    pixels = rays.astype(np.float64) @ optics.K_rect.T
    np.testing.assert_allclose(pixels[..., 2], 1)
    np.testing.assert_allclose(pixels[..., :2], optics.rectify_map(SIZE), atol=1e-3)
    fine = optics.rays(SIZE, 2)
    assert fine.shape == (48, 128, 3)
    np.testing.assert_allclose(fine.reshape(24, 2, 64, 2, 3).mean((1, 3)), rays, atol=1e-4)


def test_a_lens_that_cannot_be_undone_is_refused(make_event_settings: MakeSettings) -> None:
    wide = make_event_settings(camera={"focal_px": 30.0}, events={"distortion": -0.3})
    _, optics = drawn(wide)
    with pytest.raises(ConfigurationError, match=r"events\.distortion is -0\.3.*nearer to 0"):
        optics.rectify_map(SIZE)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_only_the_whole_composition_gives_the_true_extrinsic(
    make_event_settings: MakeSettings, index: int
) -> None:
    rig, optics = drawn(make_event_settings(), index)

    def turned(number: int) -> NDArray[np.float64]:
        transform = np.eye(4)
        transform[:3, :3] = optics.R_rect[number]
        return transform

    def composed(*steps: NDArray[np.floating]) -> NDArray[np.float64]:
        return np.asarray(
            np.linalg.inv(np.linalg.multi_dot([optics.T_lidar_camRect1, *steps])), float
        )

    back = np.linalg.inv(turned(0))
    right = composed(turned(1), optics.T_10, back)
    np.testing.assert_allclose(right, rig.T_cam_lidar, atol=1e-12)
    for wrong in (
        composed(turned(1), optics.T_10),
        composed(optics.T_10, back),
        composed(turned(1), back),
        composed(turned(1), np.linalg.inv(optics.T_10), back),
        composed(turned(1), optics.T_10, turned(0)),
    ):
        assert np.abs(wrong - rig.T_cam_lidar).max() > 2e-3


def test_cameras_of_a_rig_have_their_distances(make_event_settings: MakeSettings) -> None:
    _, optics = drawn(make_event_settings())
    # The right camera's origin, seen from the left one, is to the right: -R' t has x > 0.
    for transform, baseline in ((optics.T_10, 0.045), (optics.T_21, 0.51), (optics.T_32, 0.045)):
        origin = -transform[:3, :3].T @ transform[:3, 3]
        assert origin[0] == pytest.approx(baseline, abs=0.02)
        assert np.abs(origin[1:]).max() < 0.02
