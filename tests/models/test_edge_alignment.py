from dataclasses import replace

import pytest
import torch
from torch import Tensor

from uncal.data.network_input import NetworkInput
from uncal.edges.image import blurred
from uncal.edges.sweep import COLUMNS, KIND, STRENGTH
from uncal.errors import ConfigurationError, UncalError
from uncal.geometry import invert, transform_points
from uncal.geometry.decalibration import DecalibrationRange, decalibrate
from uncal.models.answer import Answer
from uncal.models.edge_alignment import EdgeAlignment, EdgeAlignmentEstimator, score
from uncal.models.operators import EAGER
from uncal.models.pose_search import SearchSettings
from uncal.recordings.frame import FrameId

RANGE = DecalibrationRange(rotation_deg=1.0, translation_cm=10.0)
K = torch.tensor([[230.0, 0.0, 103.5], [0.0, 230.0, 39.5], [0.0, 0.0, 1.0]])
T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
SETTINGS = SearchSettings(samples=128, effective=20, widening=1.3)


def frame(seed: int) -> tuple[Tensor, Tensor]:
    """(3, 80, 208) image of boxes at all depths and the (M, columns) edges of their outlines."""
    generator = torch.Generator().manual_seed(seed)
    image, rows = torch.zeros(80, 208), []
    for top in range(4, 76, 18):
        for left in range(4, 204, 20):
            shape = torch.rand(6, generator=generator)
            y, x = top + int(4 * shape[0]), left + int(4 * shape[1])
            height, width = 7 + int(5 * shape[2]), 8 + int(6 * shape[3])
            image[y : y + height, x : x + width] = 0.3 + 1.5 * shape[4]
            depth = 4.0 * 10.0 ** float(shape[5])
            right, bottom = x + width - 0.5, y + height - 0.5
            for along, at in ((0, x - 0.5), (0, right), (3, y - 0.5), (3, bottom)):
                for step in torch.linspace(0.2, 0.8, 4).tolist():
                    u, v = (at, y + step * height) if along == 0 else (x + step * width, at)
                    ray = torch.linalg.inv(K) @ torch.tensor([u, v, 1.0])
                    edge = torch.zeros(len(COLUMNS))
                    edge[:3] = transform_points(invert(T), (ray * depth)[None])[0]
                    edge[KIND], edge[STRENGTH] = along, 0.5
                    rows.append(edge)
    return image.expand(3, -1, -1), torch.stack(rows)


def batch(decalibration: Tensor, frames_of_unit: int = 1, most: int = 10_000) -> NetworkInput:
    """n units of that many frames."""
    n = len(decalibration)
    made = [frame(seed) for seed in range(n * frames_of_unit)]
    unit = torch.arange(n).repeat_interleave(frames_of_unit)
    x = torch.stack([image for image, _ in made])
    return NetworkInput(
        x=x,
        inverse_depth=torch.zeros(len(x), 1, 80, 208),
        K=K.expand(len(x), 3, 3),
        T_init=decalibrate(T, decalibration[unit]),
        target=decalibration,
        unit_index=torch.arange(n),
        frames=[FrameId("rig", "drive", i) for i in range(len(x))],
        unit=unit,
        edges=torch.stack([thinned(edges, most) for _, edges in made]),
    )


def thinned(edges: Tensor, most: int) -> Tensor:
    return edges[torch.randperm(len(edges), generator=torch.Generator().manual_seed(0))[:most]]


def rows(whole: NetworkInput, first: int, last: int) -> NetworkInput:
    """Units of single frames of a batch."""
    cut = slice(first, last)
    return NetworkInput(
        x=whole.x[cut],
        inverse_depth=whole.inverse_depth[cut],
        K=whole.K[cut],
        T_init=whole.T_init[cut],
        target=whole.target[cut],
        unit_index=torch.arange(last - first),
        frames=whole.frames[cut],
        unit=torch.arange(last - first),
        edges=whole.edges[cut],
    )


def estimator(settings: SearchSettings = SETTINGS) -> EdgeAlignmentEstimator:
    network = EdgeAlignment(
        3,
        3,
        "mean",
        15,
        kinds=[1.0, 0.5, 0.3, 1.0, 0.3, 0.3],
        blur_deg=[0.75, 0.37, 0.2],
        rounds=[3, 3, 3],
        sharpness=[0.3] * 3,
        every=[1, 1, 1],
    )
    return EdgeAlignmentEstimator(network, RANGE.bounds, settings)


def drawn(n: int) -> Tensor:
    torch.manual_seed(1)
    return RANGE.draw(n)


def answer_of(model: EdgeAlignmentEstimator, inputs: NetworkInput) -> Answer:
    question = model.question(inputs)
    return model.answer(model.repeated(*question.arguments)[None], inputs, question)


def test_finds_a_known_decalibration() -> None:
    truth = drawn(4)
    error = (estimator().pose(batch(truth)) - truth).abs().mean(0) / truth.abs().mean(0)

    assert error.mean() < 0.3


def test_frames_of_a_window_add_up() -> None:
    truth = drawn(2)
    alone, window = batch(truth, 1, most=150), batch(truth, 4, most=150)

    one, four = answer_of(estimator(), alone), answer_of(estimator(), window)

    assert four.samples.shape == (1, 2, 6)
    assert one.covariance is not None
    assert four.covariance is not None
    assert torch.logdet(four.covariance).lt(torch.logdet(one.covariance)).all()


def test_same_estimate_in_any_batch_and_at_any_time() -> None:
    whole = batch(drawn(3))
    together = estimator().pose(whole)

    apart = torch.cat([estimator().pose(rows(whole, i, i + 1)) for i in range(3)])

    torch.testing.assert_close(apart / RANGE.bounds, together / RANGE.bounds, atol=2e-3, rtol=0)
    assert torch.equal(estimator().pose(whole), together)


def test_covariance_is_positive_and_the_pose_within_the_range() -> None:
    answer = answer_of(estimator(), batch(drawn(2)))

    assert answer.covariance is not None
    relative = answer.covariance / RANGE.bounds[:, None] / RANGE.bounds
    assert torch.linalg.eigvalsh(relative).gt(0).all()
    assert (answer.samples.abs() <= RANGE.bounds).all()


def test_without_edges_nothing_is_known() -> None:
    inputs = batch(drawn(1))
    inputs = inputs._replace(edges=torch.full_like(inputs.edges, torch.nan))

    answer = answer_of(estimator(replace(SETTINGS, samples=512)), inputs)

    assert answer.covariance is not None
    sigma = answer.covariance.diagonal(dim1=1, dim2=2).sqrt() / RANGE.bounds
    torch.testing.assert_close(sigma, torch.full((1, 6), 3**-0.5), atol=0.1, rtol=0)
    assert (answer.samples.abs() < 0.15 * RANGE.bounds).all()


def test_score_reads_the_map_of_each_edges_direction() -> None:
    strength = torch.zeros(1, 2, 80, 208)
    strength[0, 0, 40, 100], strength[0, 1, 40, 100] = 2.0, 5.0
    ray = torch.linalg.inv(K) @ torch.tensor([100.0, 40.0, 1.0])
    edges = torch.zeros(1, 2, len(COLUMNS))
    edges[0, :, :3] = transform_points(invert(T), (ray * 7.0)[None])
    edges[0, 1, KIND] = 3

    found = score(strength, edges, torch.tensor([[1.0, 10.0]]), K[None], T[None, None])

    torch.testing.assert_close(found, torch.tensor([[52.0]]), atol=1e-2, rtol=0)


def test_blur_of_an_image_does_not_depend_on_its_neighbours() -> None:
    maps = torch.rand(2, 2, 20, 30)
    both = blurred(maps, torch.tensor([0.8, 3.0]))

    torch.testing.assert_close(both[:1], blurred(maps[:1], torch.tensor([0.8])))


@pytest.mark.parametrize(("surround", "rises"), [(0.0, True), (3.0, False)])
def test_edges_are_not_drawn_to_where_the_image_has_many(surround: float, rises: bool) -> None:
    network = EdgeAlignment(
        3, 3, "mean", 15, [1.0] * 6, [0.2], [4], [0.3], [1], surround=[surround]
    )
    denser_to_the_right = torch.linspace(0.0, 1.0, 208).expand(1, 2, 80, 208)

    strength = network.unusual(denser_to_the_right, K[:1, 0], 0, EAGER)[..., 10:-10]

    rise = (strength[..., -1] - strength[..., 0]).mean().item()
    assert (rise > 0.5) is rises
    assert rises or abs(rise) < 1e-4


def test_has_nothing_to_train() -> None:
    model = estimator()

    assert not list(model.parameters())
    with pytest.raises(UncalError, match="no parameters"):
        model.loss(batch(drawn(1)))


def test_settings_are_checked() -> None:
    with pytest.raises(ConfigurationError, match="samples=4"):
        SearchSettings(samples=4, effective=8, widening=1.3)
    with pytest.raises(ConfigurationError, match="as many of each"):
        EdgeAlignment(3, 3, "mean", 15, [1.0] * 6, [0.7, 0.3], [4], [0.3], [1])
    with pytest.raises(ConfigurationError, match="as many of each"):
        EdgeAlignment(3, 3, "mean", 15, [1.0] * 6, [0.7], [4], [0.3], [1], [0, 2])
    with pytest.raises(ConfigurationError, match="0 or more than 1"):
        EdgeAlignment(3, 3, "mean", 15, [1.0] * 6, [0.7], [4], [0.3], [1], [0.5])
