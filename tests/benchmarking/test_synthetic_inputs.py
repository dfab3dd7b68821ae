from typing import cast

import pytest
import torch
from hydra import compose, initialize_config_dir

from uncal.benchmarking.latency import synthetic_inputs
from uncal.models.answer import Estimator
from uncal.runs.assembly import build_module
from uncal.settings.configuration import CONFIG_DIR


@pytest.mark.parametrize("case", ["demo", "xxs"])
def test_a_case_asks_what_its_stochastic_passes_repeat(case: str) -> None:
    with initialize_config_dir(CONFIG_DIR, version_base="1.3"):
        settings = compose("benchmark").cases[case]
        model = compose("train", [*settings.model, "model.inputs.edges=50"])
    module = build_module(model).eval()
    asked = cast(Estimator, module.estimator)
    edges = 50 if case == "demo" else 0
    inputs = synthetic_inputs((64, 96), 2, edges, torch.device("cpu"))
    assert inputs.edges.shape[:2] == (2, edges)
    with torch.no_grad():
        question = asked.question(inputs)
        output = asked.repeated(*question.arguments)
    assert output.shape == (2, 27 if case == "demo" else 6)
    assert output.isfinite().all()
