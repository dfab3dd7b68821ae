import torch
from torch import nn

from uncal.uncertainty.conformal.split_conformal import AbsoluteCalibrator
from uncal.uncertainty.dropout.mc_dropout import MCDropout, SinglePass


def network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(
        nn.Linear(3, 16), nn.BatchNorm1d(16), nn.ReLU(), nn.Dropout(0.5), nn.Linear(16, 6)
    )


def test_it_is_the_network_with_dropout_off_in_whatever_mode_it_is() -> None:
    subject, x = network(), torch.randn(4, 3)
    subject.eval()
    expected = subject(x)
    subject.train()
    prediction = SinglePass(subject)(x, seed=[1, 2, 3, 4])
    torch.testing.assert_close(prediction.mean, expected.detach(), rtol=0, atol=0)
    assert bool((prediction.std == 0).all())
    assert prediction.passes == 1
    assert all(module.training for module in subject.modules())


def test_samples_are_kept_when_asked_for() -> None:
    engine = SinglePass(network().eval())
    engine.keep_samples = True
    samples = engine(torch.randn(4, 3)).samples
    assert samples is not None
    assert samples.shape == (1, 4, 6)


def test_a_calibrator_knows_it_from_mc_dropout() -> None:
    subject = network().eval()
    single, many = SinglePass(subject).identity(), MCDropout(subject, 5).identity()
    assert single.passes == 1
    assert single.rates == ()
    assert single.weights == many.weights
    assert any("passes" in difference for difference in single.differences(many))


def test_intervals_from_absolute_errors_need_no_spread() -> None:
    engine = SinglePass(network().eval())
    x, target = torch.randn(50, 3), torch.randn(50, 6)
    prediction = engine(x)
    calibrator = AbsoluteCalibrator()
    calibrator.fit(prediction.mean, prediction.std, target, identity=engine.identity())
    intervals = calibrator.predict(prediction.mean, prediction.std, 0.9)
    rounding = 1e-5  # one of the samples lies on the bound itself
    inside = (intervals.lower - rounding <= target) & (target <= intervals.upper + rounding)
    # Of the very samples that it was fitted with, ⌈51 · 0.9⌉ = 46 lie inside.
    assert inside.sum(0).tolist() == [46] * 6
