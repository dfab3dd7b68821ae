from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml  # type: ignore[import-untyped]
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from uncal.errors import (
    CalibrationMissing,
    ConfigurationError,
    FrameError,
    NothingPaired,
    RecordingError,
    RotationError,
)
from uncal.recordings.frame import Recording
from uncal.recordings.plain_folder import PlainFolder
from uncal.recordings.point_files import read_point_file
from uncal.settings.check import refuse_values
from uncal.settings.configuration import CONFIG_DIR

SIZE = (48, 64)
T = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, 0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]])
POINTS = np.array([[4.0, 1, 0, 0.5], [8.0, -1, 0.5, 1.0]], np.float32)


def rig(**camera: object) -> dict[str, object]:
    front = {"K": [50.0, 50.0, 31.5, 23.5], "size": [64, 48], **camera}
    return {
        "name": "my_rig",
        "cameras": {"front": front, "rear": {"K": [40.0, 40.0, 30.0, 20.0]}},
        "lidars": {"top": {"units": "mm"}, "side": None},
        "extrinsics": {"front": {"top": T.tolist()}, "rear": {"side": T.tolist()}},
    }


def write(root: Path, content: dict[str, object], n: int = 3) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    (root / "rig.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    rng = np.random.default_rng(0)
    for number in range(n):
        for camera in ("front", "rear"):
            folder = root / "monday" / camera
            folder.mkdir(parents=True, exist_ok=True)
            image = rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
            cv2.imwrite(
                str(folder / f"{number:03d}.{'png' if camera == 'front' else 'jpg'}"), image
            )
        for lidar, scale in (("top", 1000.0), ("side", 1.0)):
            folder = root / "monday" / lidar
            folder.mkdir(parents=True, exist_ok=True)
            (POINTS * np.array([scale] * 3 + [1.0], np.float32)).tofile(
                folder / f"{number:03d}.bin"
            )
    return root


def test_cameras_and_lidars_by_name_and_units(tmp_path: Path) -> None:
    root = write(tmp_path / "root", rig())
    recording = PlainFolder(root)
    assert isinstance(recording, Recording)
    assert str(recording.frame_ids[0]) == "my_rig/monday/0000000000"
    frame = recording.load(recording.frame_ids[1])
    np.testing.assert_allclose(frame.points, POINTS, rtol=1e-6)
    np.testing.assert_array_equal(frame.T_cam_lidar, T)
    rear = PlainFolder(root, "rear", "side").load(recording.frame_ids[0])
    assert rear.K[0, 0] == 40.0
    assert rear.image is not None
    assert rear.image.shape == (*SIZE, 3)
    with pytest.raises(ConfigurationError, match="front, rear"):
        PlainFolder(root, "left")
    with pytest.raises(RecordingError, match=r"extrinsics\.front\.side"):
        PlainFolder(root, "front", "side")


@pytest.mark.parametrize(
    ("model", "lens"), [("radtan", [-0.2, 0.05, 0.0, 0.0]), ("fisheye", [0.05, 0.0, 0.0, 0.0])]
)
def test_undistorted_points_meet_undistorted_pixels(
    tmp_path: Path, model: str, lens: list[float]
) -> None:
    """A dot where the lens puts a point comes to where K of the frame projects that point."""
    distortion = {"model": model, "coefficients": lens}
    root = write(tmp_path / "root", rig(distortion=distortion))
    K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    point = np.array([[[0.30, -0.18, 1.0]]])
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    zero = np.zeros(3)
    pixel = project(point, zero, zero, K, np.array(lens))[0].ravel()
    image = np.zeros(SIZE, np.uint8)
    cv2.circle(image, np.round(pixel * 16).astype(int).tolist(), 32, 255, -1, cv2.LINE_AA, 4)
    cv2.imwrite(str(root / "monday" / "front" / "000.png"), image)
    frame = PlainFolder(root).load(PlainFolder(root).frame_ids[0])
    assert frame.image is not None
    grey = frame.image[..., 0].astype(float)
    rows, columns = np.indices(SIZE)
    found = np.array([(grey * columns).sum(), (grey * rows).sum()]) / grey.sum()
    expected = (frame.K @ point.ravel())[:2]
    np.testing.assert_allclose(found, expected, atol=0.25)


def test_rotations_in_every_form(tmp_path: Path) -> None:
    forms: list[dict[str, object]] = [
        {"translation": [0.1, 0.2, 0.3], "rotation": T[:3, :3].tolist()},
        {"translation": [100, 200, 300], "units": "mm", "rotation_deg": [0, -90, 90]},
        {"translation": [0.1, 0.2, 0.3], "rotation_rad": [0, -np.pi / 2, np.pi / 2]},
        {"translation": [0.1, 0.2, 0.3], "quaternion_xyzw": [0.5, -0.5, 0.5, 0.5]},
    ]
    for number, form in enumerate(forms):
        content = rig() | {"extrinsics": {"front": {"top": form}}}
        root = write(tmp_path / str(number), content, n=1)
        found = PlainFolder(root).load(PlainFolder(root).frame_ids[0]).T_cam_lidar
        np.testing.assert_allclose(found, T, atol=1e-6)


def test_pairs_by_time_within_a_tolerance(tmp_path: Path) -> None:
    root = write(tmp_path / "root", rig() | {"pairing": {"tolerance_s": 0.02}})
    (root / "monday/front/timestamps.txt").write_text("0.10\n0.21\n0.35\n")
    (root / "monday/top/timestamps.txt").write_text("0.00\n0.11\n0.20\n")
    recording = PlainFolder(root)
    pairs = [recording.paths(frame) for frame in recording.frame_ids]
    assert [(i.stem, s.stem) for i, s in pairs] == [("000", "001"), ("001", "002")]
    assert recording.load(recording.frame_ids[0]).time == 0.11
    assert "100 ms" in next(iter(recording.skipped.values()))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    root = write(tmp_path / "root", rig())
    (root / "monday/top/002.bin").unlink()
    assert len(PlainFolder(root).frame_ids) == 2
    assert list(PlainFolder(root).skipped) == ["my_rig/monday/002.png"]
    for scan in (root / "monday/top").iterdir():
        scan.unlink()
    with pytest.raises(NothingPaired, match="scan missing"):
        PlainFolder(root)
    (root / "rig.yaml").unlink()
    with pytest.raises(RecordingError, match=r"rig\.yaml"):
        PlainFolder(root)


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"extrinsics": {"front": {"top": (1.02 * T).tolist()}}}, RotationError, "rotation"),
        ({"cameras": {"front": {"K": [50.0, 50.0]}}}, RecordingError, "fx, fy, cx, cy"),
        ({"lidars": {"top": {"units": "inch"}}}, RecordingError, "m, cm, mm"),
        ({"sensors": {}}, RecordingError, "unknown sensors"),
        (
            {"cameras": {"front": {"K": [5, 5, 1, 1], "distortion": {"model": "fisheye"}}}},
            RecordingError,
            "coefficients",
        ),
    ],
)
def test_wrong_files_are_refused(
    tmp_path: Path, change: dict[str, object], error: type[Exception], match: str
) -> None:
    with pytest.raises(error, match=match):
        PlainFolder(write(tmp_path / "root", rig() | change, n=1))


def test_calibration_missing_is_said(tmp_path: Path) -> None:
    from uncal.recordings.plain_calibration import read_rig

    with pytest.raises(CalibrationMissing, match="own-rig"):
        read_rig(tmp_path / "rig.yaml")


def test_every_scan_format_has_the_same_points(tmp_path: Path) -> None:
    POINTS.tofile(tmp_path / "a.bin")
    np.save(tmp_path / "a.npy", POINTS)
    pcd = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\n"
        "COUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA "
    )
    text = "\n".join(" ".join(map(str, row)) for row in POINTS.tolist()) + "\n"
    (tmp_path / "ascii.pcd").write_text(pcd + "ascii\n" + text)
    (tmp_path / "binary.pcd").write_bytes((pcd + "binary\n").encode() + POINTS.tobytes())
    ply = "element vertex 2\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "intensity")
    )
    for name, kind in (("a", "ascii"), ("le", "binary_little_endian"), ("be", "binary_big_endian")):
        head = f"ply\nformat {kind} 1.0\n{ply}end_header\n".encode()
        body = {"a": text.encode(), "le": POINTS.tobytes(), "be": POINTS.astype(">f4").tobytes()}
        (tmp_path / f"{name}.ply").write_bytes(head + body[name])
    for path in sorted(tmp_path.iterdir()):
        points, n_dropped = read_point_file(path)
        np.testing.assert_array_equal(points, POINTS, err_msg=path.name)
        assert n_dropped == 0
        path.write_bytes(path.read_bytes()[:-9])
        with pytest.raises(FrameError, match=path.name):
            read_point_file(path)
    with pytest.raises(FrameError, match=r"\.pcd"):
        read_point_file(tmp_path / "a.xyz")


def test_las_through_laspy(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    las = laspy.create(point_format=0)
    las.header.scales = np.full(3, 0.001)
    las.x, las.y, las.z = POINTS[:, :3].T
    las.intensity = np.array([10, 20], np.uint16)
    las.write(tmp_path / "a.las")
    points, _ = read_point_file(tmp_path / "a.las")
    np.testing.assert_allclose(points[:, :3], POINTS[:, :3], atol=1e-3)
    assert points[:, 3].tolist() == [10, 20]


def test_the_dataset_reads_it(tmp_path: Path) -> None:
    root = write(tmp_path / "root", rig())
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        choices = ["dataset=folder", f"dataset.root={root}", "dataset.lidar=top"]
        config = compose("train", choices)
    refuse_values(config, None)
    recording = instantiate(config.dataset.recording)
    assert isinstance(recording, PlainFolder)
    assert len(recording.frame_ids) == 3
