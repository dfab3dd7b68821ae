import numpy as np
import pytest

from uncal.data.image_size import resize_and_crop
from uncal.errors import ConfigurationError

K = np.array([[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]])


def test_a_world_point_stays_on_the_same_image_feature() -> None:
    image = np.zeros((375, 1242, 3), np.uint8)
    ray = np.array([0.1, 0.05, 1.0])
    u, v, _ = K @ ray
    # A bright blob centred on the projection, wide enough to survive the reduction.
    rows, columns = np.mgrid[0:375, 0:1242]
    image[...] = (255 * np.exp(-((rows - v) ** 2 + (columns - u) ** 2) / 50.0))[..., None]
    small, K_small = resize_and_crop(image, K, (192, 640))
    weight = small[..., 0].astype(float)
    rows, columns = np.mgrid[0:192, 0:640]
    centre = [(columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()]
    u_small, v_small, _ = K_small @ ray
    assert small.shape == (192, 640, 3)
    np.testing.assert_allclose(centre, [u_small, v_small], atol=0.05)


def test_the_crop_is_centred_and_moves_the_principal_point() -> None:
    image = np.arange(100 * 60 * 3, dtype=np.uint8).reshape(60, 100, 3)
    cropped, K_cropped = resize_and_crop(image, K, (60, 80))
    np.testing.assert_array_equal(cropped, image[:, 10:90])
    np.testing.assert_allclose(K_cropped, K - [[0, 0, 10], [0, 0, 0], [0, 0, 0]])


def test_the_right_size_is_left_alone() -> None:
    image = np.ones((80, 208, 3), np.uint8)
    same, K_same = resize_and_crop(image, K, (80, 208))
    assert same is image
    np.testing.assert_array_equal(K_same, K)
    assert K_same is not K


def test_a_size_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="image_size"):
        resize_and_crop(np.zeros((4, 4, 3), np.uint8), K, (0, 10))
