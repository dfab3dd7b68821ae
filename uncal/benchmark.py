"""What stochastic passes cost and are worth: ``python -m uncal.benchmark``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, cast

import hydra
from hydra import compose
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig

from uncal.errors import ConfigurationError
from uncal.settings.command_line import quote_arguments
from uncal.settings.configuration import CONFIG_DIR, exits_on_error, quiet_libraries
from uncal.settings.help_page import show_help

if TYPE_CHECKING:
    import torch


@hydra.main(version_base="1.3", config_path=CONFIG_DIR, config_name="benchmark")
@exits_on_error
def main(config: DictConfig) -> None:
    """Measure, write, show."""
    # Here and not above: they take seconds, which --help has no use for.
    import pandas as pd
    import torch

    from uncal.benchmarking.latency import measure_latency, synthetic_inputs
    from uncal.benchmarking.tables import write_latency, write_trade
    from uncal.benchmarking.trade import measure_trade
    from uncal.models.answer import Estimator
    from uncal.runs.assembly import build_module
    from uncal.runs.checkpoint import read_recipe
    from uncal.settings.check import check_settings
    from uncal.system.memory import keep_freed_memory

    keep_freed_memory()
    quiet_libraries()
    check_settings(config)
    if config.ckpt is not None:  # before minutes are measured
        read_recipe(Path(config.ckpt))
        if config.data_root is not None and not Path(config.data_root).is_dir():
            raise ConfigurationError(f"data_root={config.data_root}: no such folder")
    folder = Path(HydraConfig.get().runtime.output_dir)
    device = pick_device(config.device)
    compiled = device.type == "cuda" if config.compile == "auto" else bool(config.compile)
    where = f"{device_name(device)}, {torch.get_num_threads()} threads, torch {torch.__version__}"
    rows, text = pd.DataFrame(), ""
    for case in filter(None, (config.cases or {}).values()):
        try:
            model = compose("train", overrides=[*case.model, "mcd.chunk=auto"])
        except HydraException as error:
            reason = str(error).splitlines()[0]
            raise ConfigurationError(f"cases: model={list(case.model)}: {reason}") from error
        estimator = cast(Estimator, build_module(model).to(device).eval().estimator)
        for batch in case.batches:
            inputs = synthetic_inputs(
                tuple(case.size), batch, int(model.model.inputs.edges), device
            )
            with torch.no_grad():
                question = estimator.question(inputs)
            measured = measure_latency(
                f"{case.name} {case.size[0]}×{case.size[1]}",
                estimator.repeated,
                question.arguments,
                config.passes,
                config.rounds,
                compiled,
            )
            rows = pd.concat([rows, measured])
            # After every block, so that an interrupted run leaves what it has measured.
            text = write_latency(folder, rows, config.passes, config.rounds, where)
    if len(rows):
        sys.stdout.write(f"\n{text}\n{folder}/latency.csv\n")
    if config.ckpt is not None:
        trade, label = measure_trade(Path(config.ckpt), config.data_root, config.rounds, device)
        text = write_trade(folder, trade, label, config.ckpt, where)
        sys.stdout.write(f"\n{text}\n{folder}/trade.png\n")
    elif rows.empty:
        raise ConfigurationError("no case and no ckpt: there is nothing to measure")


def pick_device(name: str) -> torch.device:
    """The device to measure on.

    Raises:
        ConfigurationError: another name, or a GPU that is not there.
    """
    import torch

    from uncal.inference.inference_settings import choice

    choice("device", name, ("auto", "cpu", "cuda"))
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigurationError("device=cuda: torch finds no GPU here; use device=cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def device_name(device: torch.device) -> str:
    """For people."""
    import torch

    return torch.cuda.get_device_name(device) if device.type == "cuda" else "CPU"


if __name__ == "__main__":
    show_help("benchmark.yaml")
    quote_arguments()
    main()
