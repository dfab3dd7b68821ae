import pytest
import torch
from torch import Tensor

from uncal.errors import ConfigurationError
from uncal.models.correlation import PAIRS, EdgeCorrelation


def boxes(shift: tuple[int, int]) -> Tensor:
    """Bright boxes before a dark wall; the LiDAR sees them (row, column) pixels away."""
    torch.manual_seed(0)
    image = torch.zeros(1, 3, 96, 192)
    depth = torch.full((1, 1, 96, 192), 0.02)
    for _ in range(14):
        row, column = int(torch.randint(8, 70, ())), int(torch.randint(8, 160, ()))
        height, width = int(torch.randint(8, 20, ())), int(torch.randint(8, 20, ()))
        box = (..., slice(row, row + height), slice(column, column + width))
        image[box] = torch.rand(1).item() + 0.5
        depth[box] = 0.1
    depth = depth.roll(shift, (2, 3))
    return torch.cat([image, depth, 10 * depth], 1)


@pytest.mark.parametrize(("rows", "columns"), [(0, 0), (4, 0), (0, -6), (-2, 6)])
def test_the_peak_is_where_the_image_has_what_the_lidar_sees(rows: int, columns: int) -> None:
    correlation = EdgeCorrelation(image_channels=3, radius=4)
    volume = correlation(boxes((rows, columns))).unflatten(1, (PAIRS, 81))
    # The LiDAR's copy lies (rows, columns) further; the image's is that much back, in 2 px cells.
    expected = (-rows // 2 + 4) * 9 + (-columns // 2 + 4)
    for pair in (0, 1):  # depth jumps across columns, across rows
        evidence = volume[0, pair].mean((1, 2)).unflatten(0, (9, 9))
        if pair == 0:  # vertical edges tell columns
            assert int(evidence.mean(0).argmax()) == expected % 9
        else:
            assert int(evidence.mean(1).argmax()) == expected // 9


@pytest.mark.parametrize("edges", ["density", "channels"])
def test_events_of_both_signs_are_edges_too(edges: str) -> None:
    x = boxes((0, -6))
    signed = x[:, :1] * torch.tensor([1.0, -1.0])[None, :, None, None]  # cancels in the mean
    events = torch.cat([signed, x[:, 3:]], 1)
    volume = EdgeCorrelation(2, 4, edges)(events).unflatten(1, (PAIRS, 81))
    evidence = volume[0, 0].mean((1, 2)).unflatten(0, (9, 9))
    assert int(evidence.mean(0).argmax()) == 4 + 3
    blind = EdgeCorrelation(2, 4, "mean")(events)
    assert blind.abs().max() == 0.0


def test_one_channel_has_the_same_edges_in_every_way() -> None:
    x = boxes((2, 2))[:, 2:]
    one, other, third = (EdgeCorrelation(1, 2, e)(x) for e in ("mean", "density", "channels"))
    torch.testing.assert_close(one, other)
    torch.testing.assert_close(one, third)


def test_unknown_edges_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="image_edges=sobel"):
        EdgeCorrelation(3, 2, "sobel")


def test_shapes_and_no_gradient() -> None:
    correlation = EdgeCorrelation(image_channels=3, radius=2)
    x = boxes((0, 0)).requires_grad_()
    volume = correlation(x)
    assert volume.shape == (1, correlation.out_channels, 12, 24) == (1, 125, 12, 24)
    assert not volume.requires_grad
    assert not list(correlation.parameters())


def test_brightness_and_contrast_hardly_matter() -> None:
    x = boxes((2, 2))
    brighter = x.clone()
    brighter[:, :3] = 3.0 * brighter[:, :3] + 1.0
    correlation = EdgeCorrelation(image_channels=3, radius=2)
    a, b = correlation(x), correlation(brighter)
    assert (a - b).abs().mean() < 0.1 * a.abs().mean()


def test_an_empty_sweep_gives_no_evidence() -> None:
    x = boxes((0, 0))
    x[:, 3:] = 0.0
    assert EdgeCorrelation(3, 2)(x).abs().max() == 0.0


def test_a_radius_of_nothing_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="radius=0"):
        EdgeCorrelation(3, 0)
