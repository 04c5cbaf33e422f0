"""A plain picture of a floor plan, with the size of its pixels given by the user: light is free, dark is a wall."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasklift.plans.pictures import Picture, is_picture, plan_from
from tasklift.plans.plan import Plan
from tasklift.plans.source import Source

TITLE = "plain picture (PNG, PGM, JPEG, BMP, TIFF, …) with --resolution"
# map_server's usual thresholds, with the greys of map_saver
FREE_FROM, WALL_BELOW = 206, 90


def recognises(source: Source) -> bool:
    """Whether it begins like a picture."""
    return is_picture(source.head)


def read(source: Source) -> Plan:
    """Read the picture; what is transparent is unknown.

    Raises
    ------
    TaskliftError
        Without a resolution, or where the picture is damaged.
    """
    if source.resolution_m is None:
        raise source.fault(
            "is a picture; give the YAML file beside it, which says how large a pixel is, or the size of a pixel in "
            "metres: --resolution 0.05"
        )
    picture = Picture(source.path)
    doubts = ["the picture is a JPEG, which blurs walls; PNG or PGM would not"] if picture.is_jpeg else []
    return plan_from(
        picture,
        _classify,
        name=source.path.stem,
        resolution_m=source.resolution_m,
        origin=(0.0, 0.0, 0.0),
        doubts=tuple(doubts),
    )


def _classify(
    mean: NDArray[np.float32], alpha: NDArray[np.float32] | None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    seen = np.ones(mean.shape, bool) if alpha is None else alpha >= 128
    return seen & (mean >= FREE_FROM), ~seen | ((mean < FREE_FROM) & (mean >= WALL_BELOW))
