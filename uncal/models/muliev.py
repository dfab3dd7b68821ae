"""MuLi-Ev (Cocheteux et al., arXiv 2405.18021): UniCal on the events of an event camera."""

from __future__ import annotations

from uncal.models.unical import UniCal


class MuliEv(UniCal):
    """The network of :class:`~uncal.models.unical.UniCal`, reading events in place of RGB.

    The publication's event representation, window and layer table were not found, so they are
    settings: ``model/inputs/events``, ``dataset.window_ms`` and ``model/backbone``. Only the inputs
    differ; the class has a name of its own so that configurations and checkpoints say what it is.
    """
