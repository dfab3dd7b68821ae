"""What a monitor's intervals were calibrated on: references, or the weights' own frames."""

from __future__ import annotations

from pathlib import Path

from uncal.errors import ConfigurationError
from uncal.monitor.evidence import EvidenceReader
from uncal.monitor.references import References, find_references, fingerprint, references_beside
from uncal.monitor.settings import MonitorSettings
from uncal.uncertainty.conformal.calibrator import IntervalCalibrator


def references_of(
    given: str | Path | References | None,
    weights: Path,
    reader: EvidenceReader,
    settings: MonitorSettings,
) -> References | None:
    """The references that a user names, or else those beside the weights.

    Args:
        given: them, their file, or None.
        weights: file of the weights.
        reader: of the evidence that they must have been made with.
        settings: that they must have been made with.

    Raises:
        ConfigurationError: they were made otherwise, or cannot be read.
    """
    if isinstance(given, References):
        return given
    made_with = fingerprint(reader, settings)
    if given is not None:
        return References.load(Path(given), made_with)
    return find_references(weights, made_with)


def without_references(weights: Path) -> str:
    """What a user must know where there are none."""
    return (
        f"No references ({references_beside(weights)} is not there): window=1, intervals of single "
        "frames as the weights were calibrated, and nothing says when inputs are unlike those. "
        "python -m uncal.monitor calibrate=FOLDER makes references from recordings with trusted "
        "extrinsics."
    )


def own_calibrator(reader: EvidenceReader, weights: Path) -> IntervalCalibrator:
    """Of single frames, as it comes with the weights.

    Args:
        reader: whose network was calibrated.
        weights: file of the weights, for the message.

    Raises:
        ConfigurationError: there is none that fits, or none of σ.
    """
    calibrator = reader.module.calibrator
    if not calibrator.is_fitted or not calibrator.needs_std or calibrator.needs_bounds:
        raise ConfigurationError(
            f"{weights}: has no calibration of σ that the monitor could use; make references: "
            "python -m uncal.monitor calibrate=FOLDER"
        )
    calibrator.check_matches(reader.module.engine.identity())
    return calibrator


def level_of_drifts(settings: MonitorSettings, references: References) -> tuple[float, str | None]:
    """The level at which references can tell a drift, and a note where it is not the one asked for.

    Args:
        settings: with the level that is asked for.
        references: which may be too few for it.
    """
    asked, unit = settings.drift.level, settings.exchangeable
    highest = references.highest_level(unit)
    if asked <= highest:
        return asked, None
    note = (
        f"drift.level={asked:g} needs more references than there are "
        f"({references.count(unit)} {unit}s): {highest:g} is used"
    )
    return max(highest, settings.level), note
