import torch

from uncal.data.augmentation import Augmentation, mirror
from uncal.data.dataset import Batch
from uncal.edges.evidence import project_edges
from uncal.edges.sweep import COLUMNS, KIND, KINDS, N_ACROSS, SIDE
from uncal.geometry import pose_to_matrix
from uncal.geometry.projection import project
from uncal.recordings.frame import FrameId

CAMERA_FROM_LIDAR = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])


def batch(n: int) -> Batch:
    torch.manual_seed(0)
    xyz = torch.rand(n, 4000, 3) * torch.tensor([30.0, 30.0, 8.0]) - torch.tensor([0.0, 15.0, 4.0])
    columns = torch.rand(n, 500, len(COLUMNS))
    columns[..., KIND] = torch.randint(0, len(KINDS), (n, 500)).float()
    columns[..., SIDE] = torch.randint(0, 2, (n, 500)).float() * 2 - 1
    edges = torch.cat([xyz[:, :500], columns[..., 3:]], -1)
    return Batch(
        unit_index=torch.arange(n),
        unit=torch.arange(n),
        frames=[FrameId("rig", "drive", i) for i in range(n)],
        camera=torch.randint(0, 256, (n, 3, 40, 64), dtype=torch.uint8),
        points=torch.cat([xyz, torch.rand(n, 4000, 1)], -1),
        edges=edges,
        K=torch.tensor([[60.0, 0.0, 30.2], [0.0, 58.0, 19.6], [0.0, 0.0, 1.0]]).repeat(n, 1, 1),
        T_cam_lidar=CAMERA_FROM_LIDAR @ pose_to_matrix(0.1 * torch.randn(n, 6)),
        decalibration=None,
        skipped=[],
    )


def test_the_mirrored_rig_sees_the_mirrored_scene() -> None:
    plain = batch(3)
    flipped = mirror(plain, torch.tensor([True, False, True]))
    before = project(plain.points, plain.T_cam_lidar, plain.K, (40, 64))
    after = project(flipped.points, flipped.T_cam_lidar, flipped.K, (40, 64))
    for b, is_flipped in enumerate([True, False, True]):
        expected = before.inverse_depth[b].flip(-1) if is_flipped else before.inverse_depth[b]
        image = plain.camera[b].flip(-1) if is_flipped else plain.camera[b]
        assert torch.equal(flipped.camera[b], image)
        # Points on a pixel's border round to the other side when mirrored.
        assert torch.isclose(after.inverse_depth[b], expected).float().mean() > 0.998
    torch.testing.assert_close(
        torch.linalg.det(flipped.T_cam_lidar[:, :3, :3]), torch.ones(3), atol=1e-5, rtol=0.0
    )


def test_brightness_and_contrast_leave_the_geometry_alone() -> None:
    plain = batch(4)
    changed = Augmentation(mirror=0.0, brightness=0.3, contrast=0.3)(plain)
    assert not torch.equal(changed.camera, plain.camera)
    assert changed.camera.dtype == torch.uint8
    assert torch.equal(changed.points, plain.points)
    assert torch.equal(changed.T_cam_lidar, plain.T_cam_lidar)


def test_no_augmentation_is_no_change() -> None:
    plain = batch(2)
    assert Augmentation(mirror=0.0, brightness=0.0, contrast=0.0)(plain) is plain


def test_events_are_mirrored_and_nothing_else() -> None:
    torch.manual_seed(1)
    events = torch.randn(3, 5, 40, 64).half()
    changed = Augmentation(mirror=1.0, brightness=0.3, contrast=0.3)(
        batch(3)._replace(camera=events)
    )
    assert changed.camera.dtype == torch.float16
    assert torch.equal(changed.camera, events.flip(-1))


def test_mirrored_edges_lie_on_the_mirrored_image() -> None:
    plain = batch(2)
    flipped = mirror(plain, torch.tensor([True, False]))
    before, after = (
        project_edges(each.edges, each.K, each.T_cam_lidar, (40, 64), torch.ones(6))
        for each in (plain, flipped)
    )
    seen = (before.seen * after.seen).bool()
    assert (before.seen == after.seen).float().mean() > 0.99
    assert seen[0].sum() > 20
    expected = before.pixels.clone()
    expected[0, :, 0] = 63 - expected[0, :, 0]
    torch.testing.assert_close(after.pixels[seen], expected[seen], atol=1e-3, rtol=0.0)
    # Left and right change places, up and down do not.
    across = plain.edges[..., KIND] < N_ACROSS
    turned = across & torch.tensor([[True], [False]])
    assert torch.equal(flipped.edges[..., SIDE], plain.edges[..., SIDE] * (1 - 2 * turned.float()))
    others = [i for i in range(len(COLUMNS)) if i not in (1, SIDE)]
    assert torch.equal(flipped.edges[..., others], plain.edges[..., others])
