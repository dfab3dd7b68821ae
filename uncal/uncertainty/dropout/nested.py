"""Tensors inside the arguments and outputs of a network: tuples, lists, dicts, dataclasses."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

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
