import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.edges.image import IMAGE_EDGES, STRONGEST, box_mean, edge_maps


def step(height: float, channels: int = 3) -> Tensor:
    """(1, C, 12, 16): brighter from column 8 on."""
    image = torch.zeros(1, channels, 12, 16)
    image[..., 8:] = height
    return image


@pytest.mark.parametrize("how", IMAGE_EDGES)
def test_a_step_between_columns_and_one_between_rows(how: str) -> None:
    across, along = edge_maps(step(1.0), 4, how)[0]
    assert (along == 0).all()
    assert (across[:, 7:9] > 1.0).all()
    assert (across[:, :7] == 0).all()
    assert (across[:, 9:] == 0).all()
    # Halfway between the two columns: both alike.
    torch.testing.assert_close(across[:, 7], across[:, 8])
    turned = edge_maps(step(1.0).transpose(2, 3), 4, how)[0]
    torch.testing.assert_close(turned[1], across.T)
    torch.testing.assert_close(turned[0], along.T)


def test_strength_is_relative_to_what_is_usual_nearby() -> None:
    faint, strong = (edge_maps(step(height), 2)[0, 0, 6, 8].item() for height in (0.5, 5.0))
    assert faint < strong < 1.5 * faint
    # Ten times as strong elsewhere in the image changes nothing here.
    two = torch.zeros(1, 1, 12, 64)
    two[..., 8:] = 0.5
    two[..., 50:] = 5.5
    assert edge_maps(two, 2)[0, 0, 6, 8].item() == pytest.approx(faint)


def test_noise_of_a_plain_area_is_no_edge_and_edges_have_a_limit() -> None:
    torch.manual_seed(0)
    noise = 0.003 * torch.randn(1, 3, 24, 24)
    assert edge_maps(noise, 5).max() < 0.2
    line = torch.zeros(1, 1, 40, 40)
    line[..., 20:] = 100.0
    assert edge_maps(line, 19).max() == STRONGEST
    assert edge_maps(torch.full((1, 3, 8, 8), 0.7), 3).max() == 0.0


def test_channels_of_opposite_sign_cancel_in_their_mean_alone() -> None:
    events = step(1.0, channels=2)
    events[:, 1] *= -1
    assert edge_maps(events, 3, "mean").max() == 0.0
    assert edge_maps(events, 3, "channels").max() > 1.0


def test_means_of_squares_with_the_border_repeated() -> None:
    torch.manual_seed(0)
    x = torch.randn(2, 1, 9, 11)
    padded = F.pad(x, (2, 2, 2, 2), mode="replicate")
    expected = F.avg_pool2d(padded, 5, 1)
    torch.testing.assert_close(box_mean(x, 2), expected)


def test_wide_means_are_nearly_those_of_their_squares() -> None:
    assert torch.allclose(box_mean(torch.full((1, 2, 30, 50), 0.3), 15), torch.tensor(0.3))
    torch.manual_seed(0)
    x = torch.rand(1, 1, 60, 80)
    expected = F.avg_pool2d(F.pad(x, (15, 15, 15, 15), mode="replicate"), 31, 1)
    assert (box_mean(x, 15) - expected).abs().max() < 0.1
    inside = (slice(None), slice(None), slice(20, 40), slice(20, 60))
    assert (box_mean(x, 15) - expected)[inside].abs().max() < 0.03
