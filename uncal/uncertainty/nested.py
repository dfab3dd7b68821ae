"""Tensors inside the arguments of a network: nested tuples, lists and dicts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from torch import Tensor


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


def map_tensors(tree: object, function: Callable[[Tensor], Tensor]) -> object:
    """The same structure with a function applied to every tensor; the rest stays as it is.

    >>> import torch
    >>> map_tensors((torch.ones(1), ["as it is"]), lambda tensor: tensor + 1)
    (tensor([2.]), ['as it is'])
    """
    if isinstance(tree, Tensor):
        return function(tree)
    if isinstance(tree, Mapping):
        return {key: map_tensors(value, function) for key, value in tree.items()}
    if isinstance(tree, tuple):
        values = tuple(map_tensors(value, function) for value in tree)
        make = getattr(type(tree), "_make", None)  # of a namedtuple
        return values if make is None else make(values)
    if isinstance(tree, list):
        return [map_tensors(value, function) for value in tree]
    return tree
