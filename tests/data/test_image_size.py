import numpy as np
import pytest

from uncal.data.image_size import fit, fit_focal, resize_and_crop, size_at_focal
from uncal.errors import ConfigurationError, FrameError

K = np.array([[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]])


def test_a_world_point_stays_on_the_same_image_feature() -> None:
    image = np.zeros((375, 1242, 3), np.uint8)
    ray = np.array([0.1, 0.05, 1.0])
    u, v, _ = K @ ray
    # A bright blob centred on the projection, wide enough to survive the reduction.
    rows, columns = np.mgrid[0:375, 0:1242]
    image[...] = (255 * np.exp(-((rows - v) ** 2 + (columns - u) ** 2) / 50.0))[..., None]
    small, K_small = resize_and_crop(image, K, fit((375, 1242), (192, 640)), (192, 640))
    weight = small[..., 0].astype(float)
    rows, columns = np.mgrid[0:192, 0:640]
    centre = [(columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()]
    u_small, v_small, _ = K_small @ ray
    assert small.shape == (192, 640, 3)
    np.testing.assert_allclose(centre, [u_small, v_small], atol=0.05)


def test_the_crop_is_centred_and_moves_the_principal_point() -> None:
    image = np.arange(100 * 60 * 3, dtype=np.uint8).reshape(60, 100, 3)
    cropped, K_cropped = resize_and_crop(image, K, fit((60, 100), (60, 80)), (60, 80))
    np.testing.assert_array_equal(cropped, image[:, 10:90])
    np.testing.assert_allclose(K_cropped, K - [[0, 0, 10], [0, 0, 0], [0, 0, 0]])


def test_the_right_size_is_left_alone() -> None:
    image = np.ones((80, 208, 3), np.uint8)
    same, K_same = resize_and_crop(image, K, fit((80, 208), (80, 208)), (80, 208))
    assert same is image
    np.testing.assert_array_equal(K_same, K)
    assert K_same is not K


def test_a_size_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="image_size"):
        fit((4, 4), (0, 10))


@pytest.mark.parametrize("wanted", [230.0, 460.0, 721.5, 1000.0])
@pytest.mark.parametrize("source", [(375, 1242), (370, 1226), (376, 1241)])
def test_images_of_any_size_come_to_a_focal_length(source: tuple[int, int], wanted: float) -> None:
    focal = float(K[0, 0])
    size = size_at_focal(source, focal, wanted)
    assert size[0] % 8 == size[1] % 8 == 0
    how = fit_focal(source, focal, wanted, size)
    # The largest such size: less than 8 pixels are cropped.
    assert 0 <= how.resized[0] - size[0] < 8
    assert 0 <= how.resized[1] - size[1] < 8
    K_new = how.camera_matrix(K)
    # Whole pixels: the focal length is met to half a pixel in as many as the image has.
    assert K_new[0, 0] == pytest.approx(wanted, rel=0.51 / how.resized[1])
    assert K_new[1, 1] == pytest.approx(wanted, rel=0.51 / how.resized[0])
    image, K_image = resize_and_crop(np.zeros((*source, 3), np.uint8), K, how, size)
    assert image.shape == (*size, 3)
    np.testing.assert_array_equal(K_image, K_new)


def test_a_world_point_stays_on_its_feature_at_another_focal_length() -> None:
    ray = np.array([0.1, 0.05, 1.0])
    u, v, _ = K @ ray
    rows, columns = np.mgrid[0:375, 0:1242]
    blob = 255 * np.exp(-((rows - v) ** 2 + (columns - u) ** 2) / 50.0)
    image = np.repeat(blob[..., None], 3, 2).astype(np.uint8)
    size = size_at_focal((375, 1242), 721.5, 460.0)
    how = fit_focal((375, 1242), 721.5, 460.0, size)
    small, K_small = resize_and_crop(image, K, how, size)
    weight = small[..., 0].astype(float)
    rows, columns = np.mgrid[0 : size[0], 0 : size[1]]
    centre = [(columns * weight).sum() / weight.sum(), (rows * weight).sum() / weight.sum()]
    np.testing.assert_allclose(centre, (K_small @ ray)[:2], atol=0.05)


def test_an_image_too_small_for_the_focal_length_is_a_skipped_frame() -> None:
    with pytest.raises(FrameError, match=r"370×1226.*dataset\.image_size"):
        fit_focal((370, 1226), 721.5, 460.0, (240, 792))


def test_an_image_of_the_wanted_size_is_still_brought_to_the_focal_length() -> None:
    """Cropped to the size that it had, it shows less: as the camera matrix says."""
    image = np.zeros((160, 416, 3), np.uint8)
    image[:, 312:] = 255  # an edge 104.5 px right of the centre
    K = np.array([[450.0, 0.0, 207.5], [0.0, 450.0, 79.5], [0.0, 0.0, 1.0]])
    how = fit_focal((160, 416), 450.0, 460.0, (160, 416))
    shown, K_shown = resize_and_crop(image, K, how, (160, 416))
    assert shown.shape == image.shape
    edge = int(np.argmax(shown[80, :, 0] > 127))
    expected = K_shown[0, 2] + K_shown[0, 0] / 450.0 * (311.5 - 207.5)
    assert abs(edge - 0.5 - expected) <= 1.0
