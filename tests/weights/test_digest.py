import os
import sys
from pathlib import Path
from types import ModuleType

import pytest
from torch import nn

from uncal.weights import digest
from uncal.weights.digest import (
    INFERENCE_CODE,
    PACKAGE,
    TRAINING_CODE,
    digest_of,
    digest_of_code,
    digest_of_file,
    digest_of_files,
    digest_of_network,
    meaning,
    own_code,
)

SOURCE = '''"""What it is."""
import math  # for pi


def area(r: float) -> float:
    """Of a circle."""
    return math.pi * r**2
'''


def test_every_value_counts() -> None:
    plain = {"rate": 0.25, "layers": ["a", "b"], "none": None}
    others = [
        {**plain, "rate": 0.250001},
        {**plain, "layers": ["b", "a"]},
        {**plain, "none": "None"},
        {**plain, "more": 1},
    ]
    found = {digest_of(each) for each in (plain, *others)}
    assert len(found) == 1 + len(others)
    assert all(len(each) == 16 for each in found)


def test_comments_docstrings_and_layout_do_not_count(tmp_path: Path) -> None:
    first, same, other = (tmp_path / f"{name}.py" for name in "abc")
    first.write_text(SOURCE)
    same.write_text(
        "import math\n\n"
        "def area(\n    r: float,  # radius\n) -> float:\n    return math.pi * r ** 2\n"
    )
    other.write_text(SOURCE.replace("**2", "**3"))
    assert meaning(first) == meaning(same)
    assert meaning(first) != meaning(other)


def test_a_file_that_is_no_python_counts_as_its_text(tmp_path: Path) -> None:
    path = tmp_path / "half.py"
    path.write_text("def area(")
    assert meaning(path) == "def area("


def test_a_files_size_or_time_of_change_counts_and_hidden_files_do_not(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    scan = tmp_path / "drive" / "0.bin"
    scan.write_bytes(b"1234")
    os.utime(scan, ns=(5, 5))
    before = digest_of_files(tmp_path)
    (tmp_path / ".lock").write_text("4711")
    assert digest_of_files(tmp_path) == before
    os.utime(scan, ns=(5, 6))
    touched = digest_of_files(tmp_path)
    os.utime(scan, ns=(5, 5))
    assert digest_of_files(tmp_path) == before
    scan.write_bytes(b"12345")
    os.utime(scan, ns=(5, 5))
    longer = digest_of_files(tmp_path)
    scan.rename(tmp_path / "0.bin")
    assert len({before, touched, longer, digest_of_files(tmp_path)}) == 4


def test_the_digest_of_a_recording_does_not_depend_on_where_it_lies(tmp_path: Path) -> None:
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.bin").write_bytes(b"1234")
        os.utime(tmp_path / name / "0.bin", ns=(5, 5))
    assert digest_of_files(tmp_path / "here") == digest_of_files(tmp_path / "there")


def test_one_byte_of_a_file_counts(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12")
    (tmp_path / "b").write_bytes(b"13")
    assert digest_of_file(tmp_path / "a") != digest_of_file(tmp_path / "b")


def test_all_named_folders_hold_code() -> None:
    for part in {*TRAINING_CODE, *INFERENCE_CODE}:
        assert any((PACKAGE / part).rglob("*.py")), part


def test_code_counts_by_the_folder_it_lives_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(digest, "PACKAGE", tmp_path)
    for name in ("data/dataset.py", "splits/splits.py"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("x = 1\n")

    def digested() -> str:
        own_code.cache_clear()
        return digest_of_code(("data",))

    before = digested()
    (tmp_path / "splits" / "splits.py").write_text("x = 2\n")
    assert digested() == before
    (tmp_path / "data" / "dataset.py").write_text("x = 2\n")
    assert digested() != before
    own_code.cache_clear()


def test_choosing_frames_looking_on_and_fitting_intervals_are_not_training() -> None:
    training = {path for part in TRAINING_CODE for path in (PACKAGE / part).rglob("*.py")}
    for folder in ("splits", "inference", "reporting", "callbacks", "uncertainty/conformal"):
        assert not training & set((PACKAGE / folder).rglob("*.py"))


def test_a_users_network_counts_by_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "theirs.py"
    path.write_text("layers = 3\n")
    module = ModuleType("theirs")
    module.__file__ = str(path)
    monkeypatch.setitem(sys.modules, "theirs", module)
    network_class = type("Theirs", (nn.Module,), {"__module__": "theirs"})
    network = nn.Sequential(nn.Linear(2, 2), network_class())
    before = digest_of_network(network)
    assert set(before) == {"theirs"}
    path.write_text("layers = 4\n")
    assert digest_of_network(network) != before
