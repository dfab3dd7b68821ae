"""Numbers that others have published, each with its source, to stand beside a run's."""

from uncal.reporting.published.paper import (
    PublishedError,
    PublishedPaper,
    PublishedSetting,
    PublishedValue,
    published_paper,
)

__all__ = [
    "PublishedError",
    "PublishedPaper",
    "PublishedSetting",
    "PublishedValue",
    "published_paper",
]
