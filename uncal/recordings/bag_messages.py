"""ROS messages of cameras and transforms, turned into arrays; names differ between ROS 1 and 2."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from uncal.recordings.plain_calibration import Lens

_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_BAYER = {
    "bayer_rggb8": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2RGB,
}
_LENSES = {
    "": "none", "plumb_bob": "radtan", "rational_polynomial": "radtan", "radtan": "radtan",
    "equidistant": "fisheye", "fisheye": "fisheye", "kannala_brandt": "fisheye",
}  # fmt: skip


def stamp_ns(message: Any) -> int:  # noqa: ANN401  # rosbags makes the classes at run time
    """Time of a message's header, nanoseconds."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def image_of(message: Any) -> NDArray[np.uint8]:  # noqa: ANN401
    """(H, W, 3) uint8 RGB pixels of a sensor_msgs/Image or CompressedImage.

    Raises:
        ValueError: the encoding is not known, or the message is cut off.
    """
    data = np.asarray(message.data, dtype=np.uint8)
    if not hasattr(message, "encoding"):
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f"the compressed image ({message.format}) cannot be decoded")
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
    encoding, height, width = message.encoding, message.height, message.width
    if encoding not in _CHANNELS and encoding not in _BAYER:
        known = ", ".join([*_CHANNELS, *_BAYER])
        raise ValueError(f"images are encoded as {encoding}; known are {known}")
    channels = _CHANNELS.get(encoding, 1)
    if data.size < height * message.step or message.step < width * channels:
        raise ValueError(f"the image holds {data.size} bytes, expected {height * message.step}")
    rows = data[: height * message.step].reshape(height, message.step)
    image = rows[:, : width * channels].reshape(height, width, channels)
    if encoding in _BAYER:
        return np.asarray(cv2.cvtColor(image, _BAYER[encoding]), dtype=np.uint8)
    if channels == 1:
        return np.repeat(image, 3, axis=2)
    if encoding.startswith("rgb"):
        return np.array(image[..., :3], np.uint8)
    return np.array(image[..., 2::-1], np.uint8)


def lens_of(message: Any, rectified: bool) -> Lens:  # noqa: ANN401
    """Lens of a sensor_msgs/CameraInfo; of P, not K, where images are ``rectified`` already.

    Raises:
        ValueError: the distortion model is not known, or the camera was never calibrated.
    """
    K = np.array(message.K if hasattr(message, "K") else message.k, float).reshape(3, 3)
    P = np.array(message.P if hasattr(message, "P") else message.p, float).reshape(3, 4)
    numbers = np.array(message.D if hasattr(message, "D") else message.d, float)
    size = (int(message.height), int(message.width))
    if rectified and P[0, 0] > 0:
        return Lens(P[:, :3], size)
    if not K[0, 0] > 0:
        raise ValueError("CameraInfo holds no calibration (K is 0); calibrate the camera first")
    model = message.distortion_model
    if model not in _LENSES:
        known = ", ".join(name for name in _LENSES if name)
        raise ValueError(f"CameraInfo has distortion_model {model}; known are {known}")
    if not numbers.any() or _LENSES[model] == "none":
        return Lens(K, size)
    return Lens(K, size, _LENSES[model], tuple(numbers.tolist()))


def transform_between(
    transforms: Iterable[Any], target: str, source: str
) -> NDArray[np.float64] | None:
    """(4, 4) ``T_target_source`` along a tree of TransformStamped, metres; None without a chain."""
    steps: dict[str, dict[str, NDArray[np.float64]]] = {}
    for stamped in transforms:
        parent, child = stamped.header.frame_id.strip("/"), stamped.child_frame_id.strip("/")
        q, t = stamped.transform.rotation, stamped.transform.translation
        T = np.eye(4)
        T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        T[:3, 3] = [t.x, t.y, t.z]
        steps.setdefault(child, {})[parent] = T
        steps.setdefault(parent, {})[child] = np.asarray(np.linalg.inv(T), np.float64)
    reached, front = {source.strip("/"): np.eye(4)}, [source.strip("/")]
    while front:
        frame = front.pop()
        for following, T in steps.get(frame, {}).items():
            if following not in reached:
                reached[following] = T @ reached[frame]
                front.append(following)
    return reached.get(target.strip("/"))
