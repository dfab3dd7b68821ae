import torch

from uncal.models.matching import MatchingStem, local_correlation


def test_correlation_equals_its_definition() -> None:
    torch.manual_seed(0)
    image, lidar = torch.randn(2, 5, 7, 3), torch.randn(2, 5, 7, 3)
    result = local_correlation(image, lidar, 2)
    for k, (dy, dx) in enumerate((dy, dx) for dy in range(-2, 3) for dx in range(-2, 3)):
        for y, x in ((0, 0), (2, 3), (4, 6)):
            inside = 0 <= y + dy < 5 and 0 <= x + dx < 7
            expected = (
                (image[:, y + dy, x + dx] * lidar[:, y, x]).sum(-1) if inside else torch.zeros(2)
            )
            torch.testing.assert_close(result[:, y, x, k], expected)


def test_gradients_are_right() -> None:
    torch.manual_seed(0)
    image = torch.randn(1, 3, 4, 2, dtype=torch.float64, requires_grad=True)
    lidar = torch.randn(1, 3, 4, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda a, b: local_correlation(a, b, 1), (image, lidar))


def test_a_shifted_copy_peaks_at_its_shift() -> None:
    torch.manual_seed(0)
    lidar = torch.nn.functional.normalize(torch.randn(1, 10, 12, 16), dim=-1)
    image = lidar.roll((1, -2), (1, 2))
    best = local_correlation(image, lidar, 2)[0, 3:-3, 3:-3].argmax(-1)
    assert (best == (1 + 2) * 5 + (-2 + 2)).all()


def test_the_stem_halves_twice() -> None:
    stem = MatchingStem(3, 2, width=16, descriptor=8, radius=1, out_channels=24)
    assert stem(torch.randn(2, 5, 64, 96)).shape == (2, 24, 16, 24)
