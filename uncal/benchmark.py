"""What stochastic passes cost and are worth: ``python -m uncal.benchmark``."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, cast

import hydra
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from uncal.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.errors import ConfigurationError

if TYPE_CHECKING:
    import torch

    from uncal.data.network_input import NetworkInput
    from uncal.models.answer import Estimator

log = logging.getLogger(__name__)


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="benchmark")
@exits_on_error
def main(config: DictConfig) -> None:
    """Measure, write, show.

    Args:
        config: conf/benchmark.yaml with the command line's overrides.
    """
    # Here and not above: they take seconds, which --help has no use for.
    import torch

    from uncal.assembly import build_module
    from uncal.benchmarking.latency import measure_latency
    from uncal.benchmarking.tables import write_latency, write_trade
    from uncal.benchmarking.trade import measure_trade
    from uncal.memory import keep_freed_memory
    from uncal.settings.check import check_settings

    keep_freed_memory()
    quiet_libraries()
    check_settings(config)
    folder = Path(HydraConfig.get().runtime.output_dir)
    device = pick_device(config.device)
    compiled = device.type == "cuda" if config.compile == "auto" else bool(config.compile)
    where = f"{device_name(device)}, {torch.get_num_threads()} threads, torch {torch.__version__}"
    rows, text = [], ""
    for case in filter(None, (config.cases or {}).values()):
        model = compose("train", overrides=[*case.model, "mcd.chunk=auto"])
        module = build_module(model).to(device).eval()
        estimator = cast("Estimator", module.estimator)
        for batch in case.batches:
            inputs = made_up(tuple(case.size), batch, int(model.model.inputs.edges), device)
            with torch.no_grad():
                question = estimator.question(inputs)
            rows += measure_latency(
                f"{case.name} {case.size[0]}×{case.size[1]}",
                estimator.repeated,
                question.arguments,
                config.passes,
                config.rounds,
                compiled,
            )
            # After every block, so that an interrupted run leaves what it has measured.
            text = write_latency(folder, rows, config.passes, config.rounds, where)
    if rows:
        sys.stdout.write(f"\n{text}\n{folder}/latency.csv\n")
    if config.ckpt is not None:
        trade, label = measure_trade(Path(config.ckpt), config.data_root, config.rounds, device)
        text = write_trade(folder, trade, label, config.ckpt, where)
        sys.stdout.write(f"\n{text}\n{folder}/trade.png\n")
    elif not rows:
        raise ConfigurationError("no case and no ckpt: there is nothing to measure")


def pick_device(name: str) -> torch.device:
    """The device to measure on.

    Args:
        name: auto, cpu or cuda.

    Raises:
        ConfigurationError: another name, or a GPU that is not there.
    """
    import torch

    from uncal.assembly import choice

    choice("device", name, ("auto", "cpu", "cuda"))
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigurationError("device=cuda: torch finds no GPU here; use device=cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def device_name(device: torch.device) -> str:
    """For people."""
    import torch

    return torch.cuda.get_device_name(device) if device.type == "cuda" else "CPU"


def made_up(size: tuple[int, ...], batch: int, edges: int, device: torch.device) -> NetworkInput:
    """Inputs of the right shapes: noise, a tenth of the pixels with a LiDAR point, edges ahead.

    Args:
        size: (H, W).
        batch: B, each frame a unit of its own.
        edges: M, of a sweep.
        device: where to.

    Returns:
        Input of five channels, with (B, M, columns) edges.
    """
    import torch

    from uncal.data.network_input import NetworkInput
    from uncal.edges.sweep import COLUMNS, KIND, KINDS, SIDE
    from uncal.recordings.frame import FrameId

    generator = torch.Generator().manual_seed(0)
    height, width = size
    depth = torch.rand(batch, 1, height, width, generator=generator)
    inverse_depth = torch.where(depth < 0.1, depth, 0.0)
    image = torch.randn(batch, 3, height, width, generator=generator)
    x = torch.cat([image, inverse_depth, inverse_depth], 1)
    x = x.contiguous(memory_format=torch.channels_last)
    K = torch.tensor([[230.0, 0.0, width / 2], [0.0, 230.0, height / 2], [0.0, 0.0, 1.0]])
    T = torch.tensor([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    sweep = torch.rand(batch, edges, len(COLUMNS), generator=generator)
    # Within 20° to either side and 10° up or down, 5 to 40 m away.
    depth = 5.0 + 35.0 * sweep[..., :1]
    aside = (2.0 * sweep[..., 1:3] - 1.0) * sweep.new_tensor([0.36, 0.18])
    sweep[..., :3] = depth * torch.cat([torch.ones_like(depth), aside], -1)
    sweep[..., KIND] = (len(KINDS) * sweep[..., KIND]).floor()
    sweep[..., SIDE] = sweep[..., SIDE].round() * 2 - 1
    places = torch.arange(batch, device=device)
    return NetworkInput(
        x=x.to(device),
        inverse_depth=inverse_depth.to(device),
        K=K.repeat(batch, 1, 1).to(device),
        T_init=T.repeat(batch, 1, 1).to(device),
        target=torch.zeros(batch, 6, device=device),
        place=places,
        frames=[FrameId("made", "up", number) for number in range(batch)],
        unit=places,
        edges=sweep.to(device),
    )


if __name__ == "__main__":
    main()
