"""Tensors inside the arguments and outputs of a network: tuples, lists, dicts, dataclasses."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Iterator, Mapping, MutableMapping

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
    elif dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        for field in dataclasses.fields(tree):
            yield from iterate_tensors(getattr(tree, field.name))


def map_tensors(tree: object, function: Callable[[Tensor], Tensor]) -> object:
    """The same structure with a function applied to every tensor; the rest stays as it is.

    >>> import torch
    >>> map_tensors((torch.ones(1), ["as it is"]), lambda tensor: tensor + 1)
    (tensor([2.]), ['as it is'])
    """
    if isinstance(tree, Tensor):
        return function(tree)
    if type(tree) is dict:
        return {key: map_tensors(value, function) for key, value in tree.items()}
    if isinstance(tree, MutableMapping):  # such as transformers' ModelOutput
        mapped = copy.copy(tree)
        for key, value in tree.items():
            mapped[key] = map_tensors(value, function)
        return mapped
    if isinstance(tree, Mapping):
        return {key: map_tensors(value, function) for key, value in tree.items()}
    if isinstance(tree, tuple):
        values = tuple(map_tensors(value, function) for value in tree)
        make = getattr(type(tree), "_make", None)  # of a namedtuple
        return values if make is None else make(values)
    if isinstance(tree, list):
        return [map_tensors(value, function) for value in tree]
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        fields = {
            field.name: map_tensors(getattr(tree, field.name), function)
            for field in dataclasses.fields(tree)
            if field.init
        }
        return dataclasses.replace(tree, **fields)
    return tree


def is_mappable(tree: object) -> bool:
    """Whether :func:`map_tensors` reaches all that such a value can hold.

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
        return all(is_mappable(getattr(tree, field.name)) for field in dataclasses.fields(tree))
    return False
