"""Good recordings pass; recordings broken in each way are found out."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from breaking_dsec import dsec_faults
from breaking_kitti import kitti_faults
from uncal.check import main
from uncal.checking.check import Checked, check
from uncal.checking.finding import KINDS
from uncal.errors import RecordingError

OFTEN = (
    *(
        "inverted extrinsic",
        "points in millimetres",
        "K of half the size",
        "image (events) truncated",
    ),
    *("images (events) one frame late", "no calibration"),
)


def broken(source: Path, folder: Path, fault: str, dsec: bool = False) -> Checked:
    root = folder / "root"
    shutil.copytree(source, root)
    (dsec_faults() if dsec else kitti_faults())[fault][1](root)
    return check(root, None, 8, None, quiet=True)


def errors(checked: Checked) -> set[str]:
    return {finding.kind for finding in checked.findings if finding.error}


def test_good_recordings_pass_with_support(kitti_like: Path, tmp_path: Path) -> None:
    checked = check(kitti_like, None, 8, tmp_path, quiet=True)
    assert checked.layout == "KITTI raw"
    assert checked.findings == []
    (report,) = checked.reports
    assert report.n_frames == 6
    assert report.support > 4.0
    assert Path(str(report.overlay)).stat().st_size > 10_000


def test_good_events_pass(dsec_like: Path) -> None:
    checked = check(dsec_like, None, 8, None, quiet=True)
    assert checked.layout == "DSEC"
    assert checked.findings == []


@pytest.mark.parametrize("fault", OFTEN)
def test_usual_faults_are_found(kitti_like: Path, tmp_path: Path, fault: str) -> None:
    assert errors(broken(kitti_like, tmp_path, fault)) == {kitti_faults()[fault][0]}


@pytest.mark.slow
@pytest.mark.parametrize("fault", sorted(set(kitti_faults()) - set(OFTEN)))
def test_other_faults_are_found(kitti_like: Path, tmp_path: Path, fault: str) -> None:
    assert kitti_faults()[fault][0] in errors(broken(kitti_like, tmp_path, fault))


@pytest.mark.slow
@pytest.mark.parametrize("fault", sorted(dsec_faults()))
def test_faults_of_dsec_are_found(dsec_like: Path, tmp_path: Path, fault: str) -> None:
    assert dsec_faults()[fault][0] in errors(broken(dsec_like, tmp_path, fault, dsec=True))


@pytest.mark.kitti
def test_no_false_alarm_on_real_frames(kitti_root: Path) -> None:
    checked = check(kitti_root, None, 8, None, quiet=True)
    assert checked.findings == []
    assert min(report.support for report in checked.reports) > 3.0


def test_the_command_ends_with_a_status_and_speaks_json(
    kitti_like: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(kitti_like), "--frames", "4", "--no-overlays"])
    assert "0 errors, 0 warnings" in capsys.readouterr().out
    root = tmp_path / "root"
    shutil.copytree(kitti_like, root)
    kitti_faults()["no scans"][1](root)
    with pytest.raises(SystemExit) as ended:
        main([str(root), "--json", "--no-overlays"])
    assert ended.value.code == 1
    content = json.loads(capsys.readouterr().out)
    assert content["errors"] == 1
    assert content["drives"][0]["findings"][0]["kind"] == "scans"
    assert content["drives"][0]["support"] is None


def test_other_folders_are_refused_with_the_layouts(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"rig\.yaml"):
        check(tmp_path, None, 8, None, quiet=True)


def test_every_fault_has_words_of_its_own() -> None:
    kinds = {kind for kind, _ in [*kitti_faults().values(), *dsec_faults().values()]}
    assert kinds | {"unconfirmed"} == set(KINDS)


@pytest.mark.parametrize("number", ["0", "-1", "abc", "1.5"])
def test_a_number_of_frames_is_a_count(number: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["root", f"--frames={number}"])
    assert ended.value.code == 2
    assert f"{number}: expected a whole number of at least 1" in capsys.readouterr().err
