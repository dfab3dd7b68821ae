"""Scans in the usual file formats: .bin, .npy, .pcd, .ply and, with ``laspy``, .las and .laz."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uncal.errors import FrameError
from uncal.recordings.sensor_files import read_scan

_PCD = {("F", 4): "<f4", ("F", 8): "<f8", ("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4",
        ("I", 1): "i1", ("I", 2): "<i2", ("I", 4): "<i4"}  # fmt: skip
_PLY = {"float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "char": "i1",
        "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
        "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"}  # fmt: skip
_BRIGHTNESS = ("intensity", "reflectance", "reflectivity", "i")


def read_point_file(path: Path) -> tuple[NDArray[np.float32], int]:
    """Read a scan and drop the points that are not finite.

    Returns:
        (N, 4) float32 x, y, z and brightness as the file has them (0 where it has none), N ≥ 1,
        and how many points were dropped.

    Raises:
        FrameError: the file is missing, empty, truncated, of another format, or holds no finite
            point.
    """
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise FrameError(f"{path}: expected a scan in {', '.join(READERS)}.")
    if path.suffix.lower() == ".bin":
        return read_scan(path)
    try:
        points = reader(path)
    except FrameError:
        raise
    except ImportError as error:
        raise FrameError(f"{path}: .las needs laspy: pip install 'uncal[las]'.") from error
    except Exception as error:  # whatever a damaged file makes of a parser
        raise FrameError(f"{path}: truncated or damaged ({error}); copy it again.") from error
    finite = np.isfinite(points).all(axis=1)
    if not finite.any():
        raise FrameError(f"{path}: none of its {len(points)} points is finite; copy it again.")
    return points[finite], int((~finite).sum())


def _npy(path: Path) -> NDArray[np.float32]:
    array = np.load(path, allow_pickle=False)
    if array.dtype.names:
        return _columns(array, path)
    if array.ndim != 2 or array.shape[1] < 3:
        raise FrameError(f"{path}: an array of shape {array.shape}, expected (N, 3 or 4).")
    points = np.zeros((len(array), 4), np.float32)
    points[:, : min(4, array.shape[1])] = array[:, :4]
    return points


def _pcd(path: Path) -> NDArray[np.float32]:
    content = path.read_bytes()
    header: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in header:
        end = content.index(b"\n", start)
        words = content[start:end].decode("ascii").split()
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
        start = end + 1
    names, n = header["FIELDS"], int(header["POINTS"][0])
    sizes, types = map(int, header["SIZE"]), header["TYPE"]
    counts = map(int, header.get("COUNT", ["1"] * len(names)))
    fields = [
        (f"{name}{i}" if name == "_" else name, _PCD[kind, size], (count,))
        for i, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True))
    ]
    kind = header["DATA"][0]
    if kind == "ascii":
        return _table(content[start:], names, n, path)
    if kind != "binary":
        raise FrameError(
            f"{path}: DATA {kind} is not read; save it as binary "
            "(pcl_convert_pcd_ascii_binary IN OUT 1)."
        )
    return _columns(np.frombuffer(content, np.dtype(fields), n, start), path)


def _ply(path: Path) -> NDArray[np.float32]:
    content = path.read_bytes()
    start = content.index(b"end_header")
    lines = content[:start].decode("ascii", "replace").split("\n")
    start = content.index(b"\n", start) + 1
    kind = next(line.split()[1] for line in lines if line.startswith("format"))
    first = next(i for i, line in enumerate(lines) if line.startswith("element"))
    words = lines[first].split()
    if words[1] != "vertex":
        raise FrameError(f"{path}: its first element is {words[1]}, expected vertex.")
    n, names, types = int(words[2]), [], []
    for line in lines[first + 1 :]:
        if not line.startswith("property"):
            break
        _, number, name = line.split()
        names.append(name)
        types.append(_PLY[number])
    if kind == "ascii":
        return _table(content[start:], names, n, path)
    order = ">" if "big" in kind else "<"
    dtype = np.dtype([(name, order + number) for name, number in zip(names, types, strict=True)])
    return _columns(np.frombuffer(content, dtype, n, start), path)


def _las(path: Path) -> NDArray[np.float32]:
    import laspy  # type: ignore[import-untyped]  # an extra

    scan = laspy.read(path)
    columns = [scan.x, scan.y, scan.z, scan.intensity]
    return np.stack([np.asarray(column, np.float32) for column in columns], 1)


def _table(text: bytes, names: list[str], n: int, path: Path) -> NDArray[np.float32]:
    table = np.loadtxt(io.BytesIO(text), dtype=np.float64, max_rows=n, ndmin=2)
    if len(table) != n:
        raise FrameError(f"{path}: {len(table)} of {n} points; truncated, copy it again.")
    table = table[:, : len(names)]
    rows = np.empty(n, np.dtype([(name, np.float64) for name in names[: table.shape[1]]]))
    for name, column in zip(names, table.T, strict=False):
        rows[name] = column
    return _columns(rows, path)


def _columns(array: NDArray[np.void], path: Path) -> NDArray[np.float32]:
    names = array.dtype.names or ()
    if missing := [name for name in "xyz" if name not in names]:
        raise FrameError(f"{path}: no {', '.join(missing)} among its fields {', '.join(names)}.")
    bright = next((name for name in _BRIGHTNESS if name in names), None)
    points = np.zeros((len(array), 4), np.float32)
    for column, name in enumerate([*"xyz", *([bright] if bright else [])]):
        points[:, column] = array[name].reshape(len(array))
    return points


READERS: dict[str, Callable[[Path], NDArray[np.float32]]] = {
    ".bin": lambda path: read_scan(path)[0],
    ".npy": _npy,
    ".pcd": _pcd,
    ".ply": _ply,
    ".las": _las,
    ".laz": _las,
}
"""Suffix → what reads it."""
