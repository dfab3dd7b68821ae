from pathlib import Path

from uncal.callbacks.report import skip_notes, write_skipped


def test_skipped_frames_are_counted_listed_and_written(tmp_path: Path) -> None:
    skipped = {f"rig/drive/{i:010d}": "truncated scan" for i in range(12)}
    notes = skip_notes(skipped, shown=3)
    assert notes[0].startswith("12 frames skipped")
    assert len(notes) == 4
    write_skipped(tmp_path / "skipped.csv", skipped)
    lines = (tmp_path / "skipped.csv").read_text().splitlines()
    assert lines[0] == "frame,reason"
    assert len(lines) == 13
