"""The operators of an estimate that not every runtime has."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from uncal.edges.image import blurred


class Operators(NamedTuple):
    """What an exported graph brings of its own.

    Attributes:
        cholesky: (N, 6, 6) → its lower factor.
        ndtr: cumulative normal distribution.
        blur: as :func:`uncal.edges.image.blurred`.
        inverse: of (N, 6, 6), symmetric and positive definite.
        solve: as :func:`solve`.
    """

    cholesky: Callable[[Tensor], Tensor]
    ndtr: Callable[[Tensor], Tensor]
    blur: Callable[[Tensor, Tensor], Tensor]
    inverse: Callable[[Tensor], Tensor]
    solve: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


def solve(matrix: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """Solution of A x = b, and A⁻¹.

    Args:
        matrix: A, (..., 6, 6) symmetric and positive definite.
        right: b, (..., 6).

    Returns:
        (..., 6) and (..., 6, 6).
    """
    factor = torch.linalg.cholesky(matrix)
    step = torch.cholesky_solve(right[..., None], factor).squeeze(-1)
    return step, torch.cholesky_inverse(factor)


EAGER = Operators(torch.linalg.cholesky, torch.special.ndtr, blurred, torch.linalg.inv, solve)
