"""Whether a value may be given for a parameter, by the parameter's annotation."""

from __future__ import annotations

import collections.abc
import inspect
import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from hydra.utils import get_object

_SEQUENCES = (list, tuple, set, collections.abc.Sequence, collections.abc.Iterable)
_MAPPINGS = (dict, collections.abc.Mapping)


def annotation_of(target: str, name: str) -> object:
    """The annotation of a parameter; ``Any`` where there is none that Python can read."""
    try:
        made = get_object(target)
        function = made.__init__ if inspect.isclass(made) else made
        return get_type_hints(inspect.unwrap(function)).get(name, Any)
    except Exception:  # a forward reference that only its own checker can follow
        return Any


def conforms(value: object, annotation: object) -> bool:
    """Whether a plain value fits an annotation; what is not understood fits.

    >>> conforms(1, float), conforms("a", int | None), conforms(True, int), conforms([1], list[int])
    (True, False, False, True)
    """
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return any(conforms(value, one) for one in arguments)
    if origin is Annotated:
        return conforms(value, arguments[0])
    if origin is Literal:
        return value in arguments
    if annotation is None or annotation is type(None):
        return value is None
    kind = origin or annotation
    if kind in (bool, str):
        return isinstance(value, kind)
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if kind in _SEQUENCES:
        return isinstance(value, list)
    if kind in _MAPPINGS:
        return isinstance(value, dict)
    return True


def described(annotation: object) -> str:
    """An annotation, such as int | None, for a message.

    >>> described(int | None)
    'int or None'
    """
    if get_origin(annotation) in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(described(one) for one in get_args(annotation)))
    if get_origin(annotation) is Literal:
        return " or ".join(map(str, get_args(annotation)))
    if annotation is type(None):
        return "None"
    return str(getattr(annotation, "__name__", annotation))
