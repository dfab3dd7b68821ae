"""The KITTI odometry layout; its scans are motion-compensated, those of KITTI raw are not.

::

    <root>/sequences/00/
        calib.txt                        P0..P3 and Tr
        times.txt                        optional
        image_2/000000.png               image_0, 1 grey; image_2, 3 colour
        velodyne/000000.bin              float32 x, y, z, reflectance
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from uncal.errors import RecordingError
from uncal.recordings.calibration_files import odometry_calibration, read_calibration_file
from uncal.recordings.folder_listing import (
    choose,
    contents,
    existing,
    list_numbered,
    one_of,
    subfolders,
)
from uncal.recordings.folder_recording import DriveFolder, FolderRecording
from uncal.recordings.sensor_files import read_second_times

CAMERAS: tuple[str, ...] = ("image_0", "image_1", "image_2", "image_3")
"""The camera folders of KITTI odometry, in the order of their numbers in ``calib.txt``."""

_REMEDY = """\
Expected the KITTI odometry layout:
  {root}/sequences/00/calib.txt (with the key Tr)
  {root}/sequences/00/image_2/000000.png
  {root}/sequences/00/velodyne/000000.bin
Get the colour images, the Velodyne data and the calibration files from \
https://www.cvlibs.net/datasets/kitti/eval_odometry.php, or write a simulated stand-in \
in the raw layout, to be read with dataset=kitti:
  python -m uncal.simulate root={root}"""


class KittiOdometry(FolderRecording):
    """A folder of KITTI odometry sequences. A sequence is a drive.

    The layout does not say which car setup recorded a sequence, but sequences of one setup carry
    the same calibration (00-02, 04-12, ...). They form one rig, named after the numbers in
    ``calib.txt``, ``calib-1f0e3dad``, so that a split by rig never puts one extrinsic on two sides.

    Args:
        root: folder that holds ``sequences``.
        sequences: which, all if None: names (``00``), numbers (0) or shell patterns (``0*``).
        camera: one of :data:`CAMERAS`.
        stride: keep every ``stride``-th frame of each sequence.

    Raises:
        RecordingError: the root, the sequences, the frames or the calibration are not there.
        ConfigurationError: an unknown camera, a stride below 1, a name that matches no sequence.
    """

    def __init__(
        self,
        root: str | Path,
        sequences: Sequence[str | int] | None = None,
        camera: str = "image_2",
        stride: int = 1,
    ) -> None:
        number = CAMERAS.index(one_of(camera, CAMERAS, "camera"))
        root = existing(root, _REMEDY)
        available = {name: [name] for name in find_sequences(root)}
        chosen = choose(available, _names(sequences), "sequences")
        super().__init__(
            (
                DriveFolder(
                    rig=_rig_name(folder / "calib.txt"),
                    drive=folder.name,
                    image_folder=folder / camera,
                    images=list_numbered(folder / camera, 6, ".png"),
                    scan_folder=folder / "velodyne",
                    scans=list_numbered(folder / "velodyne", 6, ".bin"),
                    calibration=odometry_calibration(folder / "calib.txt", number),
                    times=partial(read_second_times, folder / "times.txt"),
                )
                for folder in (root / "sequences" / name for name in chosen)
            ),
            stride,
        )


def _names(sequences: Sequence[str | int] | None) -> list[str] | None:
    """Sequence names; YAML and the command line turn ``[10]`` into a number."""
    if sequences is None:
        return None
    if isinstance(sequences, str):
        return [sequences]
    return [f"{name:02d}" if isinstance(name, int) else name for name in sequences]


def _rig_name(path: Path) -> str:
    # The numbers, not the bytes: copies of the file differ in line ends and in trailing blanks.
    digest = hashlib.sha256()
    for key, numbers in sorted(read_calibration_file(path).items()):
        digest.update(f"{key}:{numbers.ravel().tolist()};".encode())
    return f"calib-{digest.hexdigest()[:8]}"


def find_sequences(root: Path) -> list[str]:
    """Names of the sequence folders of a KITTI odometry root, sorted."""
    sequences = existing(root, _REMEDY) / "sequences"
    if not sequences.is_dir() and (root / "dataset" / "sequences").is_dir():
        raise RecordingError(f"{root} holds no folder 'sequences': give {root / 'dataset'}.")
    inside, missing = root, "folder 'sequences'"
    if sequences.is_dir():
        if names := subfolders(sequences):
            return names
        inside, missing = sequences, "folder such as 00"
    raise RecordingError(
        f"{inside} holds no {missing}; found {contents(inside)}. {_REMEDY.format(root=root)}"
    )
