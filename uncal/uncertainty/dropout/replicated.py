"""A tensor repeated N times along the batch that is not copied until something computes with it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import torch
from torch import Tensor
from torch.utils._pytree import tree_map_only

_Tree = TypeVar("_Tree")

_ATTRIBUTES = ("shape", "dtype", "device", "ndim")
_QUESTIONS = {
    *(getattr(Tensor, name).__get__ for name in _ATTRIBUTES),
    Tensor.size,
    Tensor.dim,
    Tensor.numel,
    Tensor.__len__,
    Tensor.is_floating_point,
}
"""What can be answered without the values."""


def iterate_tensors(tree: object) -> Iterator[Tensor]:
    """The tensors of at least one dimension, in order.

    >>> import torch
    >>> [len(t) for t in iterate_tensors(({"a": torch.zeros(3)}, [torch.ones(2)], "b"))]
    [3, 2]
    """
    if isinstance(tree, Tensor):
        if tree.ndim > 0:
            yield tree
    elif isinstance(tree, Mapping):
        for value in tree.values():
            yield from iterate_tensors(value)
    elif isinstance(tree, (tuple, list)):
        for value in tree:
            yield from iterate_tensors(value)
    elif dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        for field in dataclasses.fields(tree):
            yield from iterate_tensors(getattr(tree, field.name))


def is_mappable(tree: object) -> bool:
    """Whether ``apply_to_collection`` of lightning-utilities reaches all that a value can hold.

    >>> is_mappable(("name", [1.0, None])), is_mappable(object())
    (True, False)
    """
    if tree is None or isinstance(tree, Tensor | str | bytes | bool | int | float):
        return True
    if isinstance(tree, Mapping):
        return all(is_mappable(value) for value in tree.values())
    if isinstance(tree, tuple | list):
        return all(is_mappable(value) for value in tree)
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        fields = (getattr(tree, field.name) for field in dataclasses.fields(tree))
        return not tree.__dataclass_params__.frozen and all(map(is_mappable, fields))  # type: ignore[attr-defined]
    return False


class Replicated(Tensor):
    """N copies of a batch, one after the other: row i of copy n is row n·B + i.

    A module whose output is already known ignores its argument, which then need not exist.

    >>> lazy = Replicated(torch.tensor([[1.0], [2.0]]), times=2)
    >>> tuple(lazy.shape), (lazy + 1).tolist()
    ((4, 1), [[2.0], [3.0], [2.0], [3.0]])
    """

    source: Tensor
    times: int
    axis: int

    @staticmethod
    def __new__(cls: type[Replicated], source: Tensor, times: int, axis: int = 0) -> Replicated:
        """Remember the source, (B, ...) or, with axis 1, (length, B, ...); nothing is copied."""
        shape = [times * n if i == axis else n for i, n in enumerate(source.shape)]
        lazy: Replicated = torch.Tensor._make_wrapper_subclass(
            cls, shape, dtype=source.dtype, device=source.device
        )
        lazy.source, lazy.times, lazy.axis = source, times, axis
        return lazy

    def materialise(self) -> Tensor:
        """The copies, a new tensor that may be written to."""
        # cat, unlike expand + reshape, keeps channels_last.
        return torch.cat([self.source] * self.times, self.axis)

    def multiplied(self, left: Tensor) -> Tensor:
        """``torch.bmm(left, self)`` as one product per row of the source, without copies.

        >>> left, right = torch.rand(6, 2, 3), torch.rand(2, 3, 4)
        >>> lazy = torch.bmm(left, Replicated(right, times=3))
        >>> bool((lazy - torch.bmm(left, right.repeat(3, 1, 1))).abs().max() < 1e-6)
        True
        """
        batch, rows = len(self.source), left.shape[1]
        together = left.reshape(self.times, batch, rows, -1).transpose(0, 1).flatten(1, 2)
        product = torch.bmm(together, self.source).reshape(batch, self.times, rows, -1)
        return product.transpose(0, 1).flatten(0, 1)

    @classmethod
    def __torch_function__(
        cls,
        func: Callable[..., Any],
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> object:
        """Answer questions about the shape; make the copies for everything else."""
        with torch._C.DisableTorchFunctionSubclass():
            if func in _QUESTIONS:
                return func(*args, **(kwargs or {}))
        if func is torch.bmm and not kwargs:
            left, right = args
            if isinstance(right, Replicated) and right.axis == 0:
                return right.multiplied(_copied(left))
        return func(*_copied(args), **_copied(dict(kwargs or {})))

    @classmethod
    def __torch_dispatch__(  # type: ignore[override]
        cls,
        func: Callable[..., Any],
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> object:
        """The same, where torch's C++ code comes across the copies by itself."""
        return func(*_copied(args), **_copied(dict(kwargs or {})))


def _copied(tree: _Tree) -> _Tree:
    copied: _Tree = tree_map_only(Replicated, Replicated.materialise, tree)
    return copied
