"""Find a network's dropout layers, put some where it has none, switch on exactly those.

Layers are found by type (every subclass of torch's dropout base class, anywhere in the network) or
by name. Dropout without a module of its own cannot be found and stays off: ``F.dropout(x,
training=self.training)``, the ``dropout_p`` of ``scaled_dot_product_attention``, the ``dropout``
argument of ``nn.MultiheadAttention`` and of ``nn.LSTM``. There, :func:`insert_dropout` helps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase

import torch
from torch import Tensor, nn
from torch.nn.modules.dropout import _DropoutNd

from uncal.errors import ConfigurationError

INSERTED = "inserted_dropout"
"""Name of the child module that :func:`insert_dropout` adds to a layer."""


def dropout_layers(network: nn.Module, select: Sequence[str] | None = None) -> dict[str, nn.Module]:
    """Dropout layers of a network, active (p > 0) or not, by their names, in module order.

    Args:
        network: any network.
        select: None: all, by type. Else names, patterns of names (``head.*``) or class names
            (``Dropout2d``); a name also finds a layer of a type of its own, as long as it has a
            rate ``p``.

    Raises:
        ConfigurationError: an entry of ``select`` finds nothing.

    >>> network = nn.Sequential(nn.Dropout(0.5), nn.Linear(2, 2), nn.Dropout2d(0.1))
    >>> list(dropout_layers(network)), list(dropout_layers(network, ["Dropout2d"]))
    (['0', '2'], ['2'])
    """
    if select is None:
        return {name: module for name, module in walk(network) if isinstance(module, _DropoutNd)}
    candidates = {
        name: module
        for name, module in walk(network)
        if isinstance(getattr(module, "p", None), float | int)
    }
    found = set()
    for entry in select:
        hits = {name for name, module in candidates.items() if _matches(entry, name, module)}
        if not hits:
            raise ConfigurationError(
                f"no dropout layer is called {entry!r} or of that type; the network has "
                f"{', '.join(f'{n} ({type(m).__name__})' for n, m in candidates.items()) or 'none'}"
            )
        found |= hits
    return {name: module for name, module in candidates.items() if name in found}


def walk(network: nn.Module) -> Iterator[tuple[str, nn.Module]]:
    """``network.named_modules()`` without its nested generators, which cost more than small nets.

    >>> net = nn.Sequential(nn.Sequential(nn.ReLU()), nn.ReLU())
    >>> list(walk(net)) == list(net.named_modules())
    True
    """
    seen: set[nn.Module] = set()
    stack: list[tuple[str, nn.Module]] = [("", network)]
    while stack:
        name, module = stack.pop()
        if module in seen:
            continue
        seen.add(module)
        yield name, module
        prefix = f"{name}." if name else ""
        children = [(prefix + key, m) for key, m in module._modules.items() if m is not None]
        stack.extend(reversed(children))


def dropout_rates(network: nn.Module, select: Sequence[str] | None = None) -> dict[str, float]:
    """The probability p of every dropout layer by the layer's name, in module order.

    >>> dropout_rates(nn.Sequential(nn.Dropout(0.25), nn.Linear(2, 2), nn.Dropout(0.05)))
    {'0': 0.25, '2': 0.05}
    """
    return {name: rate_of(layer) for name, layer in dropout_layers(network, select).items()}


def rate_of(layer: nn.Module) -> float:
    """The rate p of one dropout layer."""
    return float(layer.p)  # type: ignore[arg-type]  # a plain attribute, which nn.Module cannot know


def insert_dropout(
    network: nn.Module,
    after: Sequence[str],
    p: float,
    exclude: Sequence[str] = (),
    layer: Callable[[float], nn.Module] = nn.Dropout,
) -> list[str]:
    """Let dropout follow some layers of a network that has none, in place.

    The new modules hold no parameters: names and shapes in the ``state_dict`` stay as they are, so
    that trained weights still load. They act in training too, as dropout does. Of a layer with
    several outputs (``nn.MultiheadAttention``) the first is meant. Where torch bypasses a layer
    (``nn.MultiheadAttention`` uses the weights of its ``out_proj`` without calling it), nothing
    can follow it: insert after the attention itself.

    Args:
        network: the network to change.
        after: names, patterns of names or class names: ``Linear``, ``Conv2d``,
            ``MultiheadAttention``, ``backbone.stage4.*``.
        p: the rate, in (0, 1).
        exclude: the same for layers to leave alone, above all the last, whose output is the
            answer itself.
        layer: makes the dropout layer from the rate.

    Returns:
        The names of the new dropout layers.

    Raises:
        ConfigurationError: a rate outside (0, 1), an entry of ``after`` that finds nothing, or a
            layer that has been given one before.

    >>> network = nn.Sequential(nn.Linear(2, 8), nn.ReLU(), nn.Linear(8, 1))
    >>> insert_dropout(network, after=["Linear"], p=0.2, exclude=["2"])
    ['0.inserted_dropout']
    """
    if not 0.0 < p < 1.0:
        raise ConfigurationError(f"dropout rate p = {p}; it must be in (0, 1), such as 0.1.")
    modules = {n: m for n, m in network.named_modules() if n}
    chosen: dict[str, nn.Module] = {}
    for entry in after:
        hits = {name: module for name, module in modules.items() if _matches(entry, name, module)}
        if not hits:
            kinds = sorted({type(module).__name__ for module in modules.values()})
            raise ConfigurationError(
                f"no layer is called {entry!r} or of that type to put dropout after; types in this "
                f"network: {', '.join(kinds)}"
            )
        chosen |= hits
    names = []
    for name, module in modules.items():
        if name not in chosen or any(_matches(entry, name, module) for entry in exclude):
            continue
        if hasattr(module, INSERTED):
            raise ConfigurationError(f"{name} is followed by an inserted dropout layer already")
        module.add_module(INSERTED, layer(p))
        module.register_forward_hook(_apply_inserted)
        names.append(f"{name}.{INSERTED}")
    return names


def _apply_inserted(module: nn.Module, args: object, output: object) -> object:
    inserted = getattr(module, INSERTED)
    if isinstance(output, Tensor):
        return inserted(output)
    if isinstance(output, tuple) and output and isinstance(output[0], Tensor):
        return (inserted(output[0]), *output[1:])
    raise ConfigurationError(
        f"{type(module).__name__} returns {type(output).__name__}; dropout can only follow a layer "
        "that returns a tensor, or a tuple that starts with one"
    )


@contextmanager
def only_active(network: nn.Module, active: Sequence[nn.Module]) -> Iterator[None]:
    """Some layers in training mode, all else (BatchNorm above all) in evaluation mode.

    Every module's own training flag is put back on leaving, after an exception too. Torch's fused
    inference path for transformer layers looks at the layer's flag only, and so would skip the
    dropout layers inside; it is switched off meanwhile.
    """
    # Past nn.Module.__setattr__, which would take longer than a small network's pass.
    flags = [(module.__dict__, module.training) for _, module in walk(network)]
    fastpath = torch.backends.mha.get_fastpath_enabled()
    try:
        torch.backends.mha.set_fastpath_enabled(False)
        for attributes, _ in flags:
            attributes["training"] = False
        for layer in active:
            layer.train()
        yield
    finally:
        torch.backends.mha.set_fastpath_enabled(fastpath)
        for attributes, training in flags:
            attributes["training"] = training


def _matches(entry: str, name: str, module: nn.Module) -> bool:
    return fnmatchcase(name, entry) or type(module).__name__ == entry
