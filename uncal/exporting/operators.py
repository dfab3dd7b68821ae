"""Operators of exported graphs, in place of those that their runtimes lack."""

from __future__ import annotations

import math
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional as F

from uncal.edges.image import blurred
from uncal.models.operators import EAGER, Operators


def torch_operators(reach: int) -> Operators:
    """PyTorch's own; only the blur's reach must not depend on its input.

    Args:
        reach: of the blur, pixels on each side.
    """
    return EAGER._replace(blur=partial(blurred, reach=reach))


def onnx_operators(reach: int) -> Operators:
    """Without linear algebra and kernels that are computed, which ONNX lacks.

    Args:
        reach: of the blur, pixels on each side.
    """
    blur = partial(blurred_by_shifts, reach=reach)
    return Operators(factor, normal_distribution, blur, inverse, solve)


def blurred_by_shifts(maps: Tensor, sigma: Tensor, reach: int) -> Tensor:
    """:func:`uncal.edges.image.blurred` without a kernel that is computed, which ONNX lacks.

    Args:
        maps: (1, C, H, W).
        sigma: (1,) pixels.
        reach: offsets on each side, at least 3 σ.

    >>> from uncal.edges.image import blurred
    >>> maps, sigma = torch.rand(1, 2, 20, 30), torch.tensor([1.7])
    >>> torch.allclose(blurred_by_shifts(maps, sigma, 9), blurred(maps, sigma), atol=1e-6)
    True
    """
    offsets = torch.arange(-reach, reach + 1, dtype=maps.dtype)
    kernel = torch.exp(-0.5 * (offsets / sigma).square()) * (offsets.abs() <= (3.0 * sigma).ceil())
    kernel = kernel / kernel.sum()
    height, width = maps.shape[-2:]
    rows = F.pad(maps, (0, 0, reach, reach), mode="replicate")
    maps = sum(
        (kernel[i] * rows[..., i : i + height, :] for i in range(2 * reach + 1)),
        torch.zeros_like(maps),
    )
    columns = F.pad(maps, (reach, reach, 0, 0), mode="replicate")
    return sum(
        (kernel[i] * columns[..., i : i + width] for i in range(2 * reach + 1)),
        torch.zeros_like(maps),
    )


def normal_distribution(y: Tensor) -> Tensor:
    """Cumulative normal distribution, through the error function."""
    return 0.5 * (1.0 + torch.erf(y / math.sqrt(2.0)))


def factor(matrix: Tensor) -> Tensor:
    """Lower Cholesky factor of (N, 6, 6), unrolled."""
    L = _entries(matrix)
    zero = torch.zeros_like(matrix[:, 0, 0])
    rows = [torch.stack([*row, *[zero] * (5 - i)], -1) for i, row in enumerate(L)]
    return torch.stack(rows, -2)


def _entries(matrix: Tensor) -> list[list[Tensor]]:
    """Rows of L in A = L Lᵀ, entry by entry."""
    L: list[list[Tensor]] = []
    for i in range(6):
        L.append([])
        for j in range(i + 1):
            value = matrix[:, i, j]
            for k in range(j):
                value = value - L[i][k] * L[j][k]
            L[i].append(value.sqrt() if i == j else value / L[j][j])
    return L


def inverse_factor(matrix: Tensor) -> Tensor:
    """L⁻¹ of the Cholesky factorisation A = L Lᵀ, unrolled.

    Args:
        matrix: (N, 6, 6) symmetric positive definite.

    Returns:
        (N, 6, 6) lower triangular.
    """
    L = _entries(matrix)
    X: list[list[Tensor]] = []
    zero = torch.zeros_like(matrix[:, 0, 0])
    for i in range(6):
        row = []
        for j in range(i):
            value = zero
            for k in range(j, i):
                value = value - L[i][k] * X[k][j]
            row.append(value / L[i][i])
        X.append([*row, 1.0 / L[i][i], *[zero] * (5 - i)])
    return torch.stack([torch.stack(row, -1) for row in X], -2)


def inverse(matrix: Tensor) -> Tensor:
    """A⁻¹ of (N, 6, 6), symmetric and positive definite."""
    of_factor = inverse_factor(matrix)
    return of_factor.transpose(1, 2) @ of_factor


def solve(matrix: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """:func:`uncal.models.operators.solve`, unrolled.

    Args:
        matrix: A, (N, 6, 6) symmetric and positive definite.
        right: b, (N, 6).

    Returns:
        A⁻¹ b (N, 6) and A⁻¹ (N, 6, 6).

    >>> _ = torch.manual_seed(0)
    >>> A, b = torch.randn(2, 6, 9), torch.randn(2, 6)
    >>> A = A @ A.mT + torch.eye(6)
    >>> ours, theirs = solve(A, b), EAGER.solve(A, b)
    >>> all(torch.allclose(x, y, atol=1e-5) for x, y in zip(ours, theirs, strict=True))
    True
    """
    covariance = inverse(matrix)
    return (covariance @ right[..., None])[..., 0], covariance
